"""Action spaces: how the numbers of an action say where an arm shall be at the next grid time.

A data set is exported in one of them, and a policy is served in the one that it was trained in.
The jaw is absolute in all of them. Vectors are in the arm's rcm frame. Without and with a wrist:

========  =======================================  =================================================
name      columns                                  columns behind a wrist
========  =======================================  =================================================
absolute  x, y, z, roll, jaw                       x, y, z, qx, qy, qz, qw, jaw
relative  dx, dy, dz, droll, jaw                   dx, dy, dz, drx, dry, drz, jaw
velocity  vx, vy, vz, vroll, jaw                   vx, vy, vz, wx, wy, wz, jaw
joint     yaw, pitch, insertion, roll, jaw         the same with wrist_pitch and wrist_yaw
========  =======================================  =================================================

They are the tip (and its orientation) at the next grid time, its change since the command before
(as a rotation vector), that change per second, and the same tip as joints of the instrument.

"Relative" refers to the command of the grid time before, not to the measured tip. Summed up from
the set-point at the start of a stream, the changes give the absolute commands again.

Whoever judges or plays commands has them as *targets*: x, y, z, roll and jaw, behind a wrist the
joints of ``wrist_joints`` and the jaw.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from surg_core._core import WristGeometry
from surg_core.arm_view import ArmCommands, TipPose
from surg_core.config import Arm
from surg_core.contract import ACTION_SPACES, WRISTED_ACTION_SPACES
from surg_core.transforms import (
    continuous_quaternions,
    make_pose,
    matrix_to_quaternion_xyzw,
    rotation_of,
    rotation_vector,
    virtual_tip,
)
from surg_core.wrist_joints import joints_of_tip, tip_of_joints

Array = npt.NDArray[np.float64]

ABSOLUTE, RELATIVE, VELOCITY, JOINT = ACTION_SPACES
MOVED = 4
"""Numbers of a straight arm's action before the jaw: tip and roll."""
TARGET, WRISTED_TARGET = 5, 7
"""Numbers of an arm's target, without and with a wrist."""


@dataclasses.dataclass(frozen=True)
class ActionSpace:
    """One action space; ``name`` is a key of ``contract.ACTION_SPACES``.

    ``wrists`` are those of the arms, with the turn that is known from homing on, None for a
    straight one; empty: all arms are straight.
    """

    name: str = ABSOLUTE
    wrists: tuple[WristGeometry | None, ...] = ()

    def __post_init__(self) -> None:
        """Check the name."""
        if self.name not in ACTION_SPACES:
            known = ", ".join(ACTION_SPACES)
            raise ValueError(f"action space {self.name!r}; allowed: {known}")
        if not any(self.wrists):
            object.__setattr__(self, "wrists", ())

    @property
    def is_target(self) -> bool:
        """Whether its actions are targets as they are."""
        return self.name == ABSOLUTE and not self.wrists

    def columns(self, arms: Sequence[str]) -> tuple[str, ...]:
        """Names of the columns, such as ``PSM1/dx``."""
        named = zip(arms, self._columns(len(arms)), strict=True)
        return tuple(f"{arm}/{name}" for arm, columns in named for name in columns)

    def units(self, arms: Sequence[str]) -> tuple[str, ...]:
        """Units of the columns (SI)."""
        return tuple(u for columns in self._columns(len(arms)) for u in columns.values())

    def encode(self, targets: Array, before: Array, period: float) -> Array:
        """Actions from targets.

        Args:
            targets: (K, T) in force at the grid time after each frame; T for all arms.
            before: (K, T) in force at each frame.
            period: Of the grid [s].

        Returns:
            (K, A) numbers in the order of ``columns``.
        """
        if not self.wrists:
            rows, last = _by_arm(targets), _by_arm(before)
            return self._encode(rows, last, period).reshape(targets.shape)
        parts = zip(self.wrists, self.split(targets), self.split(before), strict=True)
        return np.hstack(
            [
                self._encode(rows, last, period)
                if wrist is None
                else self._encode_wristed(wrist, rows, last, period)
                for wrist, rows, last in parts
            ]
        )

    def decode(self, rows: Array, before: Array, period: float) -> Array:
        """Targets from actions for consecutive grid times, the inverse of ``encode``.

        Args:
            rows: (K, A) actions.
            before: (T,) the target of the grid time before the first row.
            period: Of the grid [s].

        Returns:
            (K, T) targets; not numbers where no joints of a wrist hold the tip.
        """
        if not self.wrists:
            targets = self._decode(_by_arm(rows), _by_arm(before), period)
            return targets.reshape(rows.shape)
        widths = [len(columns) for columns in self._columns(len(self.wrists))]
        actions = np.split(np.asarray(rows, np.float64), np.cumsum(widths)[:-1], axis=-1)
        parts = zip(self.wrists, actions, self.split(before[None]), strict=True)
        return np.hstack(
            [
                self._decode(part, last, period)
                if wrist is None
                else self._decode_wristed(wrist, part, last[0], period)
                for wrist, part, last in parts
            ]
        )

    def split(self, targets: Array) -> list[Array]:
        """Targets (…, T) by arm."""
        if not self.wrists:
            return list(np.moveaxis(_by_arm(targets), -2, 0))
        widths = [TARGET if wrist is None else WRISTED_TARGET for wrist in self.wrists]
        return np.split(np.asarray(targets, np.float64), np.cumsum(widths)[:-1], axis=-1)

    def _columns(self, arms: int) -> Iterator[Mapping[str, str]]:
        for wrist in self.wrists or (None,) * arms:
            yield (ACTION_SPACES if wrist is None else WRISTED_ACTION_SPACES)[self.name]

    def _encode(self, rows: Array, last: Array, period: float) -> Array:
        """Of straight arms, (…, 5)."""
        actions = rows.copy()
        if self.name in (RELATIVE, VELOCITY):
            actions[..., :MOVED] -= last[..., :MOVED]
        if self.name == VELOCITY:
            actions[..., :MOVED] /= period
        if self.name == JOINT:
            actions[..., :3] = shaft_joints(rows[..., :3])
        return actions

    def _decode(self, actions: Array, before: Array, period: float) -> Array:
        """Of straight arms, (…, 5)."""
        targets = actions.copy()
        if self.name in (RELATIVE, VELOCITY):
            step = period if self.name == VELOCITY else 1.0
            moved = np.cumsum(actions[..., :MOVED] * step, axis=0)
            targets[..., :MOVED] = before[..., :MOVED] + moved
        if self.name == JOINT:
            targets[..., :3] = virtual_tip(*np.moveaxis(actions[..., :3], -1, 0))
        return targets

    def _encode_wristed(
        self, wrist: WristGeometry, rows: Array, last: Array, period: float
    ) -> Array:
        """(K, 7) or (K, 8)."""
        if self.name == JOINT:
            return np.hstack([shaft_joints(rows[:, :3]), rows[:, 3:]])
        tips = np.array([tip_of_joints(wrist, row) for row in rows])
        p, R = tips[:, :3, 3], tips[:, :3, :3]
        if self.name == ABSOLUTE:
            turns = continuous_quaternions(np.array([matrix_to_quaternion_xyzw(r) for r in R]))
        else:
            step = period if self.name == VELOCITY else 1.0
            earlier = np.array([tip_of_joints(wrist, row) for row in last])
            changes = zip(R, earlier[:, :3, :3], strict=True)
            turns = np.array([rotation_vector(now @ then.T) for now, then in changes]) / step
            p = (p - earlier[:, :3, 3]) / step
        return np.hstack([p, turns, rows[:, 6:]])

    def _decode_wristed(
        self, wrist: WristGeometry, actions: Array, before: Array, period: float
    ) -> Array:
        """(K, 7)."""
        if self.name == JOINT:
            return np.hstack([virtual_tip(*actions[:, :3].T), actions[:, 3:]])
        step = period if self.name == VELOCITY else 1.0
        X, joints = tip_of_joints(wrist, before), before
        targets = np.full((len(actions), WRISTED_TARGET), np.nan)
        for row, target in zip(actions, targets, strict=True):
            if self.name == ABSOLUTE:
                if not 0.5 < np.linalg.norm(row[3:7]) < 2.0:
                    break
                X = make_pose(row[:3], row[3:7])
            else:
                X[:3, :3] = rotation_of(step * row[3:6]) @ X[:3, :3]
                X[:3, 3] += step * row[:3]
            found = joints_of_tip(wrist, X, float(joints[3]))
            if found is None:
                break
            joints = found
            target[:] = [*joints, row[-1]]
        return targets


def wrist_of_arm(arm: Arm) -> WristGeometry | None:
    """Lengths of a cell's wrist, whose turn is not known yet; None: the instrument is straight."""
    return None if arm.instrument.wrist is None else arm.instrument.wrist.geometry


def absolute_range(arm: Arm) -> tuple[list[float], list[float]]:
    """Least and largest numbers of an arm's absolute action that can be in the workspace."""
    limits, tool = arm.limits, arm.instrument
    far = float(limits.depth_max)
    wide = far * math.sin(min(float(limits.cone), math.pi / 2))
    jaw = float(tool.jaw_min), float(tool.jaw_max)
    if tool.wrist is None:
        return [-wide, -wide, 0.0, -math.pi, jaw[0]], [wide, wide, far, math.pi, jaw[1]]
    lengths = tool.wrist.geometry
    bent = lengths.pitch_to_yaw + lengths.yaw_to_tip
    low, high = [-wide - bent, -wide - bent, -bent], [wide + bent, wide + bent, far + bent]
    return [*low, *[-1.0] * 4, jaw[0]], [*high, *[1.0] * 4, jaw[1]]


def commands_of(wrist: WristGeometry | None, target: Array) -> ArmCommands:
    """The commands that stream an arm's target (5,), behind a wrist (7,)."""
    roll, jaw = float(target[3]), float(target[-1])
    if wrist is None:
        return ArmCommands(servo_cp=TipPose(np.array(target[:3]), roll), jaw=jaw)
    X_RTip = tip_of_joints(wrist, target)
    return ArmCommands(servo_cp=TipPose(X_RTip[:3, 3], roll, X_RTip[:3, :3]), jaw=jaw)


def target_of(wrist: WristGeometry | None, pose: TipPose, jaw: float, near_roll: float) -> Array:
    """The target (5,), behind a wrist (7,), of a streamed pose; not numbers where no wrist is.

    Of equal rolls of a wristed instrument it has the one nearest to ``near_roll`` [rad].
    """
    if wrist is None:
        return np.array([*pose.p, pose.roll, jaw])
    joints = joints_of_tip(wrist, make_pose(pose.p, pose.q), near_roll)
    return np.full(WRISTED_TARGET, np.nan) if joints is None else np.append(joints, jaw)


def of_columns(
    columns: Sequence[str], arms: Sequence[str], wrists: tuple[WristGeometry | None, ...] = ()
) -> ActionSpace | None:
    """The action space with these columns for these arms, or None."""
    spaces = (ActionSpace(name, wrists) for name in ACTION_SPACES)
    return next((space for space in spaces if space.columns(arms) == tuple(columns)), None)


def shaft_joints(ends: Array) -> Array:
    """Yaw, pitch [rad] and insertion [m], (…, 3), of the shaft's ends (…, 3)."""
    x, y, z = np.moveaxis(ends, -1, 0)
    insertion = np.linalg.norm(ends, axis=-1)
    pitch = np.arcsin(np.clip(y / insertion, -1.0, 1.0))
    return np.stack([np.arctan2(x, z), pitch, insertion], axis=-1)


def _by_arm(rows: Array) -> Array:
    """(…, arms, 5) float64."""
    numbers = np.asarray(rows, dtype=np.float64)
    return numbers.reshape(*numbers.shape[:-1], -1, TARGET)
