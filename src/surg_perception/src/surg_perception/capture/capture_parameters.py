"""Parameters of the capture node. No ROS."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

from surg_perception.capture.eye_layout import FLIPS, LAYOUTS, eyes_of
from surg_perception.capture.picture_source import SourceError, SourceUri
from surg_ros.params import ParamError, flag, one_of, real, text, whole


@dataclass(frozen=True)
class CaptureSettings:
    """Parameters of the node ``/endoscope``; those of ``cell.yaml``'s section have its names."""

    source: str = text()  # KIND:ADDRESS
    layout: str = one_of(LAYOUTS)
    # folder of the cell: relative paths begin here, and its calibration/ holds the lens files
    cell: str = text("", empty=True)
    width: int = whole(0, 7680, 0)  # of a grabbed picture [px]; 0: as the device has it
    height: int = whole(0, 4320, 0)
    publish_width: int = whole(16, 7680, 960)  # largest size of a published eye [px]
    publish_height: int = whole(16, 4320, 540)
    rate: float = real(0.0, 240.0, 0.0)  # [1/s]; 0: as the device has it
    swap: bool = flag(False)  # the left eye comes where the layout has the right one
    flip: str = one_of(FLIPS, "none")
    latency: float = real(0.0, 1.0, 0.0)  # [s] from glass to stamp
    eyes: int = field(default=2, kw_only=True)  # of one device; `devices` states it

    def __post_init__(self) -> None:
        """Checks the source against the layout.

        Raises:
            ParamError: They do not fit.
        """
        if bool(self.width) != bool(self.height):
            raise ParamError("width", self.width, "width and height, or neither")
        try:
            count = len(SourceUri.parse(self.source).devices())
        except SourceError as error:
            raise ParamError("source", self.source, str(error)) from error
        if count > 2 or (count == 2 and self.layout != "two"):
            allowed = "two devices with layout two, one with every other"
            raise ParamError("source", self.source, allowed)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of a grabbed picture [px]; 0, 0: as the device has it."""
        return self.width, self.height

    def devices(self) -> tuple[CaptureSettings, ...]:
        """Settings of each device's process; the left eye's first."""
        found = SourceUri.parse(self.source).devices()
        uris = found[::-1] if self.swap and len(found) == 2 else found
        eyes = len(eyes_of(self.layout)) // len(uris)
        return tuple(replace(self, source=str(uri), eyes=eyes) for uri in uris)

    @property
    def calibration(self) -> Path | None:
        """Folder of the lens files; None: without a cell."""
        return Path(self.cell) / "calibration" if self.cell else None
