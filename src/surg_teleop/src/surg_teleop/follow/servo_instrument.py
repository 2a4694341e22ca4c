"""An instrument without a controller, moved by four servos: the assistant's.

It says where its joints are and takes joints to go to; there is no state and no gate. So what a
controller would do for a hand is done here as far as a sender can: it counts as ENABLED while it
speaks, and its set-point is the last target that it was given. After a silence it is where it is:
what was sent meanwhile may have come late, and then it was refused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surg_teleop.follow.arm_view import ArmState, ArmView, Commands, virtual_joints
from surg_teleop.follow.teleoperation import SILENCE

Array = NDArray[np.float64]


def tip(joints: Array) -> Array:
    """Tip (3,) [m] in the trocar frame of yaw, pitch [rad], insertion [m], roll [rad]."""
    yaw, pitch, insertion, _ = joints.tolist()
    s = [math.sin(yaw) * math.cos(pitch), math.sin(pitch), math.cos(yaw) * math.cos(pitch)]
    return insertion * np.array(s)


@dataclass
class VirtualArm:
    """What such an instrument looks like to a :class:`~surg_teleop.follow.teleoperation.Teleop`.

    Attributes:
        node: Caller id under which it is moved: nobody else is known of.
        R_WR: (3, 3) its trocar frame in the world of the cell.
    """

    node: str
    R_WR: Array
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
        """``jaw/measured_js`` [rad]: taken until it has been commanded."""
        if math.isnan(self._jaw):
            self._jaw = angle

    def view(self) -> ArmView | None:
        """As an arm; None before it has spoken."""
        if self._joints is None:
            return None
        at = self._joints if self._target is None else self._target
        return ArmView(
            stamp_ns=self._stamp_ns,
            state=ArmState.ENABLED,
            homed=True,
            busy=False,
            reason="",
            refused=0,
            p_set=tip(at),
            p_tip=tip(self._joints),
            roll_set=float(at[3]),
            jaw_set=self._jaw,
            holder=self.node,
            stream=self.node,
            R_WR=self.R_WR,
            received=self._received,
        )

    def obey(self, commands: Commands) -> Commands:
        """The same commands as it takes them: joints instead of a pose, and nothing else."""
        joints = None
        before = self._joints if self._target is None else self._target
        if commands.servo_cp is not None and before is not None:
            # A tip pose is a swing without any z times the roll about z.
            asked = 2.0 * math.atan2(commands.servo_cp.q[2], commands.servo_cp.q[3])
            roll = float(before[3]) + math.remainder(asked - float(before[3]), math.tau)
            joints = self._target = virtual_joints(commands.servo_cp.p, roll)
        if commands.hold:
            # Its servos go to the target and rest there: a hold ends the motion where it is.
            joints = self._target = self._joints
        if commands.jaw is not None:
            self._jaw = commands.jaw
        return Commands(stamp_ns=commands.stamp_ns, servo_jp=joints, jaw=commands.jaw)
