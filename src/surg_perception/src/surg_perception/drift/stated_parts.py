"""What the calibration of a cell states of its own errors, part by part."""

from __future__ import annotations

import numpy as np

from surg_core import ConfigError
from surg_core.base_file import load_base
from surg_core.config import Arm, Cell
from surg_core.transforms import FloatArray
from surg_perception.calibration.chain_steps import measured_camera
from surg_perception.calibration.steps import scope_arm
from surg_perception.drift.moving_parts import Part, parts_of

SHAFT_ARM = 0.1
"""[m] Length over which a tool's residual bends the shaft: that of the tip's motions about it."""
EXACT = 1e-10 * np.eye(6)
"""Covariance of the base that the others are stated in [rad^2, m^2]: of joints and encoders."""


def stated_parts(cell: Cell) -> list[Part]:
    """The parts of a calibrated cell.

    Raises:
        ConfigError: The camera or a base is not measured, or a file is stale; says what to do.
    """
    scope = scope_arm(cell).name
    camera, file = measured_camera(cell)
    of_camera = camera.through_lenses
    if of_camera is None:
        raise ConfigError(
            f"{file}: states no covariance, so nobody can tell drift from its own error; run "
            "./surg calibrate CELL handeye"
        )
    turned = np.kron(np.eye(2), camera.R_FV)  # the file's axes are the flange's
    arms = {name: _tool(arm) for name, arm in cell.arms.items() if name != scope}
    bases = {name: _base(cell, name) for name in cell.arms}
    return parts_of(scope, arms, bases, turned.T @ of_camera @ turned)


def _tool(arm: Arm) -> FloatArray:
    shift = float(arm.tool.residual) / np.sqrt(3.0)
    sd = np.repeat([shift / SHAFT_ARM, shift], 3)
    return np.asarray(np.diag(sd**2) + EXACT)


def _base(cell: Cell, name: str) -> FloatArray:
    if name == next(iter(cell.arms)):
        return EXACT
    file = cell.folder / "calibration" / f"base_{name}.yaml"
    if not file.is_file():
        raise ConfigError(f"{file}: is missing; run ./surg calibrate CELL bases --by touch first")
    return np.asarray(load_base(file).evidence.covariance)
