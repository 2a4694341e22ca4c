"""Parameters and report of the check of a camera's registration."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import surg_core
from surg_core import ConfigError
from surg_core.arm_view import Array
from surg_core.held_endoscope import HeldEndoscope, held_endoscope
from surg_ros.params import ParamError, flag, path, read, text
from surg_teleop.frames.registration_verdict import Verdict
from surg_teleop.frames.tip_tracker import Place


@dataclass(frozen=True)
class CheckTask:
    """What to check."""

    cell: surg_core.Cell
    arm: str
    camera: HeldEndoscope
    enable: bool  # home and enable the arm if needed
    lockstep: bool  # run in lock-step with the simulator
    out: Path | None  # file of the report; None: no file

    @property
    def calibrated(self) -> bool:
        """Whether the camera and every base but the first arm's are measured."""
        folder = self.cell.folder / "calibration"
        bases = [folder / f"base_{name}.yaml" for name in list(self.cell.arms)[1:]]
        return self.camera.measured and all(file.is_file() for file in bases)


@dataclass(frozen=True)
class Parameters:
    """Parameters of the node."""

    cell: str = text()
    arm: str = text("", empty=True)
    enable: bool = flag(False)
    lockstep: bool = flag(False)
    out: Path | None = path(None)


def read_task(parameters: Mapping[str, Any]) -> CheckTask:
    """Read the parameters and the cell.

    Raises:
        ParamError: A parameter is invalid.
        ConfigError: The cell is invalid.
    """
    given = read(Parameters, parameters)
    cell = surg_core.load_cell(given.cell)
    camera = held_endoscope(cell)
    if camera is None:
        raise ConfigError(
            f"check_frames: {cell.config.file}: no arm holds an endoscope (an instrument with a "
            "camera), so there is no registration to check; cells/sim_two_arms has one"
        )
    others = [name for name in cell.arms if name != camera.arm]
    arm = given.arm or (others[0] if others else "")
    if arm not in others:
        raise ParamError("arm", arm, ", ".join(others) or "none: the cell has one arm")
    return CheckTask(cell, arm, camera, given.enable, given.lockstep, given.out)


def report(verdict: Verdict, places: Mapping[str, Place], task: CheckTask) -> dict[str, Any]:
    """The verdict as JSON; NaN becomes null."""
    return {
        "format": "surg_check_frames/1",
        "cell": str(task.cell.folder),
        "arm": task.arm,
        "endoscope": task.camera.arm,
        "outcome": verdict.outcome.value,
        "cause": verdict.cause.value,
        "text": verdict.text,
        "angle_rad": None if math.isnan(verdict.angle) else round(verdict.angle, 4),
        "seen": [
            {
                "told": seen.commanded,
                "pixels": _rounded(seen.pixels),
                "disparity": None if seen.disparity is None else round(seen.disparity, 2),
            }
            for seen in verdict.seen
        ],
        "places": {
            step: {"left": _rounded(place.left), "disparity": _rounded(place.disparity)}
            for step, place in places.items()
        },
    }


def _rounded(pixels: Array | None) -> list[float] | None:
    return None if pixels is None else [round(float(value), 2) for value in pixels]
