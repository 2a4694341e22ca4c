"""``pipe:PATH``: a named pipe that another program fills with y4m or MJPEG.

A picture is stamped on arrival. FFmpeg's MJPEG parser waits for the next picture, so MJPEG is one
picture late; y4m is not.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import av

from surg_perception.capture.picture_source import Grabbed, PictureSource, SourceError, Wanted
from surg_perception.sources import av_input
from surg_recording.video.colours import Colours

FORMATS = {"y4m": "yuv4mpegpipe", "mjpeg": "mjpeg"}


class PipeSource(PictureSource):
    """One pipe. Options: ``format``: ``y4m`` (default) or ``mjpeg``."""

    keys = ("format",)

    def __init__(self, address: str, options: Mapping[str, str], wanted: Wanted) -> None:
        super().__init__(address, options, wanted)
        self._where = f"endoscope.source: pipe:{address}"
        stated = options.get("format", "y4m")
        if stated not in FORMATS:
            raise SourceError(
                "bad_address",
                f"{self._where}: option format: {stated!r}; allowed: {', '.join(FORMATS)}",
            )
        probing = {"probesize": "32", "analyzeduration": "0"}
        path = str(wanted.folder / address)
        self._container = av_input.open_input(
            self._where, path, format=FORMATS[stated], options=probing
        )
        av_input.decode_at_once(self._container)
        self._colours = Colours()

    def pictures(self) -> Iterator[Grabbed]:
        """Every picture that arrives."""
        try:
            for packet in self._container.demux(video=0):
                received = self.wanted.now()
                jpegs = (bytes(packet),) if self.wanted.coded and self._is_jpeg(packet) else ()
                for frame in packet.decode():
                    yield Grabbed(received, received, (self._colours(frame),), jpegs)
        except av.error.FFmpegError as error:
            raise av_input.refusal(self._where, error) from error
        raise SourceError("gone", f"{self._where}: the writer has closed the pipe; start it again")

    @staticmethod
    def _is_jpeg(packet: av.Packet) -> bool:
        return bool(packet.stream.codec_context.name == "mjpeg" and packet.size)

    def close(self) -> None:
        """Close the pipe."""
        self._container.close()
