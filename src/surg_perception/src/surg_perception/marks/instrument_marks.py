"""Tip, shaft, jaws and trocar of an arm in the world, by its joints and its calibrated files."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from surg_core import axis_angle_to_matrix, make_pose
from surg_core.config import Arm
from surg_core.transforms import FloatArray
from surg_core.urdf import fixed_transform, load_urdf, read_joints

SHAFT = 0.05
"""[m] How far up the shaft its line goes."""
STEPS = 11
"""Points of a line: a lens bends it."""
NO_TURN = make_pose([0.0, 0.0, 0.0], [0.0, 0.0, 0.0])


@dataclass(frozen=True)
class Mark:
    """One mark in space.

    Attributes:
        arm: Name of the arm.
        name: ``tip``, ``shaft``, ``jaw`` or ``trocar``.
        p_W: (n, 3) points in the world [m]: one, or a line's.
    """

    arm: str
    name: str
    p_W: FloatArray


@dataclass(frozen=True)
class _Finger:
    """A jaw: its pivot (3,) and axis (3,) in the flange [m]."""

    pivot: FloatArray
    axis: FloatArray


class InstrumentMarks:
    """The marks of one arm's instrument. Everything but the joints is read once."""

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        self._fingers = _fingers(arm)

    def at(self, q: FloatArray, jaw: float = float("nan")) -> list[Mark]:
        """The marks at joint positions.

        Args:
            q: (n,) joints of the arm [rad].
            jaw: Angle of each finger [rad]; NaN: unknown, and no jaw is marked.
        """
        arm = self.arm
        X_WF = np.asarray(arm.X_WB @ np.asarray(arm.chain.forward(q)))
        tip, s = np.asarray(arm.tool.p_FTip), np.asarray(arm.tool.s_F)
        up = np.linspace(0.0, SHAFT, STEPS)[:, None]
        found = [self._mark("tip", X_WF, tip[None]), self._mark("shaft", X_WF, tip - up * s)]
        if np.isfinite(jaw):
            for finger in self._fingers:
                turn = axis_angle_to_matrix(finger.axis, jaw)
                way = np.array([[0.0], [0.5], [1.0]]) * (turn @ (tip - finger.pivot))
                found.append(self._mark("jaw", X_WF, finger.pivot + way))
        p_BRcm = np.asarray(arm.trocar.p_BRcm)
        return [*found, self._mark("trocar", arm.X_WB, p_BRcm[None])]

    def _mark(self, name: str, X_WA: FloatArray, p_A: FloatArray) -> Mark:
        return Mark(self.arm.name, name, p_A @ X_WA[:3, :3].T + X_WA[:3, 3])


def _fingers(arm: Arm) -> list[_Finger]:
    """The turning parts of the instrument, where its calibrated tip puts them."""
    file, mount = arm.instrument_urdf, arm.instrument.mount_link
    drawn = np.asarray(fixed_transform(file, mount, arm.instrument.tip_link))
    moved = np.asarray(arm.tool.p_FTip) - drawn[:3, 3]
    found = []
    for joint in load_urdf(file).joints:
        if joint.kind != "revolute":
            continue
        X, axis = NO_TURN, np.zeros(3)
        for each in read_joints(file, mount, joint.child):
            X, axis = X @ each.X_PJ, each.axis
        found.append(_Finger(X[:3, 3] + moved, X[:3, :3] @ axis))
    return found
