"""An instrument driven by four servos, without a controller: the assistant's.

It reports its joints and accepts joint targets; it has no operating state and no gate. To a
:class:`Teleop` it looks like an arm that is ENABLED while it sends, and whose set-point is its last
target. After a gap the set-point is the measured position: commands sent meanwhile may have been
lost.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from surg_core.arm_view import ArmCommands, ArmState, ArmView, Array, TipPose
from surg_core.transforms import virtual_tip
from surg_teleop.follow.teleop_types import SILENCE


@dataclass
class ServoInstrument:
    """A servo-driven instrument as an arm."""

    node: str  # caller id of the only sender
    R_WR: Array  # (3, 3) its trocar frame in the world of the cell
    _joints: Array | None = None
    _target: Array | None = None
    _jaw: float = math.nan
    _received: float = -math.inf
    _stamp_ns: int = 0

    def joints(self, now: float, stamp_ns: int, joints: Array) -> None:
        """``measured_js``: yaw, pitch [rad], insertion [m], roll [rad], received now [s]."""
        if joints.shape == (4,) and np.isfinite(joints).all():
            if now - self._received > SILENCE:
                self._target, self._jaw = None, math.nan
            self._joints, self._received, self._stamp_ns = joints, now, stamp_ns

    def jaw(self, angle: float) -> None:
        """``jaw/measured_js`` [rad]; the set-point until the first command."""
        if math.isnan(self._jaw):
            self._jaw = angle

    def view(self) -> ArmView | None:
        """Its state as an arm; None before the first message."""
        if self._joints is None:
            return None
        set_point = self._joints if self._target is None else self._target
        return ArmView(
            stamp_ns=self._stamp_ns,
            state=ArmState.ENABLED,
            homed=True,
            busy=False,
            reason="",
            refused=0,
            p_BSet=virtual_tip(*set_point[:3]),
            p_BTip=virtual_tip(*self._joints[:3]),
            roll_set=float(set_point[3]),
            jaw_set=self._jaw,
            holder=self.node,
            stream=self.node,
            R_BR=np.eye(3),
            R_WB=self.R_WR,
            received=self._received,
        )

    def convert(self, commands: ArmCommands) -> ArmCommands:
        """Arm commands as servo commands: joints instead of a pose, and nothing else."""
        joints = None
        before = self._joints if self._target is None else self._target
        if commands.servo_cp is not None and before is not None:
            # The nearest of the equal rolls.
            turn = math.remainder(commands.servo_cp.roll - float(before[3]), math.tau)
            joints = TipPose(commands.servo_cp.p, float(before[3]) + turn).joints
            self._target = joints
        if commands.hold:
            # The servos would run on to their target.
            joints = self._target = self._joints
        if commands.jaw is not None:
            self._jaw = commands.jaw
        return ArmCommands(stamp_ns=commands.stamp_ns, servo_jp=joints, jaw=commands.jaw)
