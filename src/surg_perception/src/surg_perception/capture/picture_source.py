"""Where pictures come from: a source for each kind of URI, bundled or from outside.

``KIND:ADDRESS?key=value&...``. KIND is the name of a bundled source, of an entry point in the group
``surg_perception.sources``, or the path of a ``.py`` file that defines one source.
"""

from __future__ import annotations

import abc
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from urllib.parse import parse_qsl

import numpy as np
from numpy.typing import NDArray

from surg_core.plugins import PluginError, PluginKind

Image = NDArray[np.uint8]


class SourceError(Exception):
    """Why there are no pictures.

    Attributes:
        code: Short reason for tests and logs: ``no_device``, ``busy``, ``no_permission``,
            ``wrong_format``, ``no_library``, ``bad_address``, ``gone``, ``ended``, ``failed``.
    """

    def __init__(self, code: str, text: str) -> None:
        super().__init__(text)
        self.code = code


@dataclass(frozen=True)
class Grabbed:
    """What a device delivered at one time.

    Attributes:
        stamp_ns: Of the exposure, in ROS time.
        received_ns: When it arrived, in ROS time.
        pictures: (h, w, 3) RGB: one picture, or the left and the right eye's.
        jpegs: The same as the device coded them; empty: it did not.
    """

    stamp_ns: int
    received_ns: int
    pictures: tuple[Image, ...]
    jpegs: tuple[bytes, ...] = ()


@dataclass(frozen=True)
class Wanted:
    """What is asked of a device.

    Attributes:
        size: Width and height [px]; 0, 0: as the device has it.
        rate: [1/s]; 0: as the device has it.
        folder: Relative paths begin here.
        now: ROS time [ns].
        sleep: Waits so many seconds.
        monotonic: The system's monotonic clock [ns].
        coded: Whether JPEG pictures are wanted as they are, too.
    """

    now: Callable[[], int]
    sleep: Callable[[float], None]
    size: tuple[int, int] = (0, 0)
    rate: float = 0.0
    folder: Path = Path()
    coded: bool = False
    monotonic: Callable[[], int] = time.monotonic_ns


class PictureSource(abc.ABC):
    """One device, or one file. It is opened when it is made; a SourceError says why not."""

    live = True
    """Whether a sensor makes the pictures: the same picture again is then a fault, and the source
    is opened again when it has gone."""
    keys: tuple[str, ...] = ()
    """Options that may stand behind ``?``."""

    def __init__(self, address: str, options: Mapping[str, str], wanted: Wanted) -> None:
        self.address, self.options, self.wanted = address, options, wanted

    @classmethod
    def devices(cls, address: str) -> list[str]:
        """The addresses of the devices that an address names; each is read by itself."""
        return address.split("+")

    @property
    def reopen(self) -> str:
        """The address to open next time: a name that stays with the device."""
        return self.address

    @abc.abstractmethod
    def pictures(self) -> Iterator[Grabbed]:
        """Pictures until the end; a SourceError says why it ends."""

    def close(self) -> None:  # noqa: B027  (most have nothing to do)
        """Give the device back."""


SOURCES = PluginKind(
    "endoscope source",
    "surg_perception.sources",
    {
        "v4l2": "surg_perception.sources.v4l2_source",
        "file": "surg_perception.sources.file_source",
        "pipe": "surg_perception.sources.pipe_source",
        "ros": "surg_perception.sources.ros_source_node",
        "gst": "surg_perception.sources.gstreamer_source",
    },
    lambda kind: issubclass(kind, PictureSource) and kind is not PictureSource,
    "one class derived from surg_perception.capture.picture_source.PictureSource",
)


@dataclass(frozen=True)
class SourceUri:
    """A parsed URI."""

    kind: str
    address: str
    options: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))

    @classmethod
    def parse(cls, text: str) -> SourceUri:
        """Split a URI; ``gst:`` takes everything behind the colon as its pipeline.

        Raises:
            SourceError: ``bad_address``.
        """
        kind, colon, rest = text.partition(":")
        if not colon or not kind or not rest:
            raise SourceError(
                "bad_address",
                f"endoscope.source: {text!r} is not KIND:ADDRESS; kinds: "
                f"{', '.join(SOURCES.names())}, or the path of a .py file",
            )
        if kind == "gst":
            return cls(kind, rest)
        address, _, query = rest.partition("?")
        options = dict(parse_qsl(query, keep_blank_values=True))
        return cls(kind, address, MappingProxyType(options))

    def source(self) -> type[PictureSource]:
        """The class of its kind.

        Raises:
            SourceError: ``bad_address``: there is none, or it does not know an option.
        """
        try:
            found: type[PictureSource] = SOURCES.find(self.kind)
        except PluginError as error:
            raise SourceError("bad_address", f"endoscope.source: {error}") from error
        for key in self.options:
            if key not in found.keys:
                allowed = ", ".join(found.keys) or "none"
                raise SourceError(
                    "bad_address",
                    f"endoscope.source: option {key!r} of {self.kind}: is unknown; allowed: "
                    f"{allowed}",
                )
        return found

    def devices(self) -> list[SourceUri]:
        """One URI for each device."""
        return [
            SourceUri(self.kind, address, self.options)
            for address in self.source().devices(self.address)
        ]

    def open(self, wanted: Wanted) -> PictureSource:
        """Open its device.

        Raises:
            SourceError: It cannot be opened.
        """
        return self.source()(self.address, self.options, wanted)

    def __str__(self) -> str:
        query = "&".join(f"{key}={value}" for key, value in self.options.items())
        return f"{self.kind}:{self.address}{'?' if query else ''}{query}"
