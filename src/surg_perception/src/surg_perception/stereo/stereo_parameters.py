"""Parameters of the node ``/eyes``. No ROS."""

from __future__ import annotations

from dataclasses import dataclass

from surg_perception.depth.stereo_matcher import FAR, NEAR
from surg_ros.params import ParamError, flag, real, text, whole


@dataclass(frozen=True)
class StereoSettings:
    """Parameters of the node ``/eyes``."""

    cell: str = text("", empty=True)  # for marks and drift: the cell's folder
    depth: bool = flag(True)  # rectified pictures, depth, points
    marks: bool = flag(False)  # tips, shafts, jaws and trocars
    drift: bool = flag(False)  # whether instruments are seen where joints put them
    rate: float = real(0.1, 30.0, 8.0)  # [1/s] most pairs
    method: str = text("sgbm")  # as for ./surg episode depth
    near: float = real(0.005, 10.0, NEAR)  # [m]
    far: float = real(0.005, 10.0, FAR)  # [m]
    step: int = whole(1, 64, 4)  # points of each so-manieth row and column
    niceness: int = whole(0, 19, 10)  # gives way to control

    def __post_init__(self) -> None:
        """Checks the parameters against one another.

        Raises:
            ParamError: They do not fit.
        """
        if not self.near < self.far:
            raise ParamError("near", self.near, f"less than ~far, {self.far:g} m")
        if (self.marks or self.drift) and not self.cell:
            raise ParamError("cell", "", "the folder of the cell, with ~marks or ~drift")
