"""``decklink:0``: a DeckLink card of Blackmagic, by GStreamer's element ``decklinkvideosrc``.

The element loads Blackmagic's own library at run time. No card has been tried.
"""

from __future__ import annotations

from collections.abc import Mapping

from surg_perception.capture.picture_source import PictureSource, SourceError, Wanted
from surg_perception.sources import gstreamer_source

CONNECTIONS = ("auto", "sdi", "hdmi", "optical-sdi", "component", "composite", "svideo")
MOST_DEVICES = 64


class DecklinkSource(gstreamer_source.GstreamerSource):
    """One input of a card. Options: ``connection`` (``sdi``, ``hdmi``, ...), ``mode``."""

    keys = ("connection", "mode")

    def __init__(self, address: str, options: Mapping[str, str], wanted: Wanted) -> None:
        where = f"endoscope.source: decklink:{address}"
        if not address.isdigit() or int(address) >= MOST_DEVICES:
            raise SourceError(
                "bad_address", f"{where}: allowed: the number of an input, 0 to {MOST_DEVICES - 1}"
            )
        if options.get("connection", "auto") not in CONNECTIONS:
            raise SourceError(
                "bad_address",
                f"{where}: option connection: {options['connection']!r}; allowed: "
                f"{', '.join(CONNECTIONS)}",
            )
        if not options.get("mode", "auto").replace("-", "").isalnum():
            raise SourceError(
                "bad_address",
                f"{where}: option mode: {options['mode']!r}; allowed: a mode of "
                "gst-inspect-1.0 decklinkvideosrc, such as 1080p30",
            )
        super().__init__(address, options, wanted)

    @classmethod
    def devices(cls, address: str) -> list[str]:
        """The numbers of the inputs, divided by a plus sign."""
        return PictureSource.devices.__func__(cls, address)  # type: ignore[attr-defined]

    def _named(self) -> str:
        return f"decklink:{self.address}"

    def _description(self) -> str:
        connection, mode = (self.options.get(key, "auto") for key in ("connection", "mode"))
        return (
            f"decklinkvideosrc device-number={self.address} connection={connection} mode={mode} "
            "drop-no-signal-frames=true"
        )

    def _silent_failure(self) -> SourceError:
        """The element writes "Failed to acquire input" into its log and sends no message."""
        return SourceError(
            "no_library",
            f"{self._where}: the DeckLink input does not answer: install Blackmagic's Desktop "
            "Video (driver and libDeckLinkAPI.so come from Blackmagic alone), then look for the "
            "card with BlackmagicFirmwareUpdater status",
        )
