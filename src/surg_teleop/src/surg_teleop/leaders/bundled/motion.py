"""A recorded motion as a hand: it rests for a while, plays the file, and rests again."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from surg_core import matrix_to_quaternion_xyzw, rpy_to_matrix
from surg_core.hand.leader_sample import HandlePose, LeaderSample
from surg_core.transforms import multiply_quaternions
from surg_teleop.leaders.leader import LeaderError
from surg_teleop.playback.motion_file import Motion, MotionError, read_motion


class MotionLeader:
    """Plays a motion file (``surg_teleop.playback.motion_file``) at a leader's rate.

    Args:
        rate: Samples per second, 1 to 1000.
        delay: Rest at the first sample [s].
        rotation: (3,) roll, pitch, yaw of the file's axes in the view frame V [rad].
    """

    def __init__(
        self,
        file: str,
        rate: float = 30.0,
        delay: float = 3.0,
        rotation: ArrayLike = (0.0, 0.0, 0.0),
        name: str = "motion",
    ) -> None:
        if not 1.0 <= rate <= 1000.0:
            raise ValueError(f"rate: {rate:g}; allowed: 1 to 1000 Hz")
        if not 0.0 <= delay < math.inf:
            raise ValueError(f"delay: {delay:g}; allowed: 0 s or more")
        self.name = name
        self._file, self._rate, self._delay = Path(file), rate, delay
        self._R_VL = rpy_to_matrix(rotation)
        self._q_VL = matrix_to_quaternion_xyzw(self._R_VL)
        self._motion: Motion | None = None
        self._opened: float | None = None

    def open(self) -> None:
        """Read the file.

        Raises:
            LeaderError: It is not a motion.
        """
        try:
            self._motion = read_motion(self._file)
        except MotionError as error:
            raise LeaderError(str(error), self.name, "give another motion file") from error
        self._spline = self._motion.spline()
        self._opened = None

    def read(self, now: float) -> LeaderSample | None:
        """The newest sample: one every 1 / rate seconds since the first call."""
        if self._motion is None:
            return None
        if self._opened is None:
            self._opened = now
        index = math.floor((now - self._opened) * self._rate + 1e-6)
        elapsed = index / self._rate
        t = min(max(elapsed - self._delay, 0.0), self._motion.duration)
        x, y, z, roll = self._spline(t).tolist()
        q_LH = np.array([0.0, 0.0, math.sin(roll / 2.0), math.cos(roll / 2.0)])
        p_VH = self._R_VL @ np.array([x, y, z])
        return LeaderSample(
            stamp=self._opened + elapsed,
            pose=HandlePose(p_VH, multiply_quaternions(self._q_VL, q_LH)),
            grip=self._grip(t),
        )

    def close(self) -> None:
        """Forget the motion."""
        self._motion = None

    def _grip(self, t: float) -> float | None:
        """The gripper's opening as a share of the file's range, because zeros are arbitrary."""
        motion = self._motion
        assert motion is not None
        value = motion.gripper_at(t)
        if value is None or motion.gripper is None or not np.ptp(motion.gripper) > 0.0:
            return None
        return float((value - motion.gripper.min()) / np.ptp(motion.gripper))
