"""A hand for tests of the teleoperation: a leader whose every button and motion is the test's."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from surg_core.arm_view import JawRange
from surg_core.hand.leader_sample import HandlePose, HandRate, LeaderSample
from surg_teleop.follow.target_pose import StepLimits
from surg_teleop.follow.teleop_types import ControlMode, TeleopSettings
from surg_teleop.playback.workspace_fit import Workspace

WORKSPACE = Workspace(depth_min=0.030, depth_max=0.220, cone=1.0472)
STEP = StepLimits(0.25, 0.002, 2.0, math.radians(2.0), 0.1)
JAW = JawRange(0.0, 0.7)


def settings(**changes: object) -> TeleopSettings:
    """What a test's teleoperation is made of."""
    given: dict[str, object] = {
        "leader": "hand",
        "arm": "PSM1",
        "node": "/teleop",
        "workspace": WORKSPACE,
        "step": STEP,
        "depth_inserted": 0.020,
        "jaw": JAW,
        "mode": ControlMode.POSITION,
    }
    return TeleopSettings(**{**given, **changes})  # type: ignore[arg-type]


@dataclass
class Hand:
    """Where the hand is and what it presses."""

    p: np.ndarray = field(default_factory=lambda: np.array([0.3, -0.2, 0.1]))
    R: np.ndarray = field(default_factory=lambda: np.eye(3))
    says: np.ndarray | None = None  # instead of the quaternion of R
    v: np.ndarray = field(default_factory=lambda: np.zeros(3))
    roll_rate: float = 0.0
    spherical: np.ndarray | None = None
    tilt: np.ndarray | None = None
    grip: float | None = 0.0
    buttons: set[str] = field(default_factory=set)
    offers: frozenset[ControlMode] = frozenset(ControlMode)
    speaks: bool = True
    broken: bool = False
    problem: str = ""
    said: LeaderSample | None = None

    def move(self, step: np.ndarray) -> None:
        """Moves by a step in the view [m]."""
        self.p = self.p + step

    def turn(self, rotation_vector: np.ndarray) -> None:
        """Turns about axes of the view [rad]."""
        self.R = Rotation.from_rotvec(rotation_vector).as_matrix() @ self.R

    def q(self) -> np.ndarray:
        """Its quaternion x, y, z, w."""
        return Rotation.from_matrix(self.R).as_quat() if self.says is None else self.says

    def sample(self, now: float) -> LeaderSample | None:
        """Its newest sample; an old one where it does not speak."""
        if self.speaks:
            p = np.full(3, np.nan) if self.broken else self.p
            self.said = LeaderSample(
                stamp=now,
                pose=HandlePose(p, self.q()) if ControlMode.POSITION in self.offers else None,
                rate=(
                    HandRate(self.v, self.roll_rate, self.spherical, self.tilt)
                    if ControlMode.RATE in self.offers
                    else None
                ),
                grip=self.grip,
                buttons=frozenset(self.buttons),
                problem=self.problem,
            )
        return self.said
