"""Where an arm's tip and shaft can go through its trocar: joints, speed and clearance.

The samples lie on rays: from the home shaft axis outwards, at several depths. Along each ray the
joints are continued from the last sample, as in a motion. A ray ends where the arm cannot follow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from surg_core._core import OtherArm, rcm_frame
from surg_core.clearance import clearance_setup
from surg_core.config import Arm, Cell
from surg_core.transforms import FloatArray, axis_angle_to_matrix, skew

HOME_MISS = 0.01
"""Largest distance of the shaft from its trocar at home [m]."""
_STEP = 0.026  # [rad] 1.5 degrees from sample to sample of a ray
_DEPTHS, _TURNS = 13, 24
_NEWTON = 20  # steps at most
_SOLVED = 1e-7  # [m, rad]
_JUMP = 0.5  # [rad] farther from the last sample is another posture of the arm
_SLOW = 0.005  # [m/s] a tip that may only be slower than this stands at a singularity


@dataclass(frozen=True)
class Reach:
    """What one arm can do, over tilt (n,), turn (m,) and depth (k,) of the tip.

    Attributes:
        arm: Its name.
        tilts: Angles between shaft and home axis [rad].
        turns: Directions of the tilt about the home axis, from x of the rcm frame [rad].
        depths: Of the tip behind the trocar [m].
        q: (n, m, k, joints) joint positions [rad]; where the tip cannot get, the last ones.
        reached: (n, m, k) bool, whether the tip can get there on its ray.
        margin: (n, m, k) distance of the nearest joint from its limit [rad].
        speed: (n, m, k) tip speed in any direction at which no joint is too fast [m/s].
        clearance: (n, m, k) distance to the other arms at home and to the obstacles [m]; infinite
            without any. Not a number where the tip cannot get, as in the two before.
        nearest: The closest pair of bodies of all samples; empty without any.
        nearest_joint: The joint that comes nearest to its limit.
        distance: The distance that the cell keeps [m]; 0: no guard.
    """

    arm: str
    tilts: FloatArray
    turns: FloatArray
    depths: FloatArray
    q: FloatArray
    reached: np.ndarray
    margin: FloatArray
    speed: FloatArray
    clearance: FloatArray
    nearest: tuple[str, str]
    nearest_joint: str
    distance: float

    @property
    def free(self) -> np.ndarray:
        """(n, m, k) bool: reached, and no closer to anything than the cell allows."""
        return np.asarray(self.reached & ~(self.clearance < self.distance))

    def share(self, where: np.ndarray) -> float:
        """Share of the workspace's volume in which ``where`` (n, m, k) holds."""
        weight = np.sin(self.tilts)[:, None, None] * (self.depths**2)[None, None, :]
        weight = np.broadcast_to(weight, where.shape)
        return float((weight * where).sum() / weight.sum())

    def full_to(self, where: np.ndarray) -> float:
        """The largest tilt [rad] up to which ``where`` holds in all directions, at all depths."""
        whole = where.all(axis=(1, 2))
        return float(self.tilts[int(np.argmin(whole)) - 1]) if not whole.all() else self.tilts[-1]

    def first_gap(self, where: np.ndarray) -> tuple[float, float, float] | None:
        """Tilt, turn [rad] and depth [m] of the sample with the least tilt without ``where``."""
        gaps = np.argwhere(~where)
        if not len(gaps):
            return None
        i, j, k = gaps[0]
        return float(self.tilts[i]), float(self.turns[j]), float(self.depths[k])


def reach(cell: Cell, name: str) -> Reach:
    """Sample where an arm of a cell can go. The other arms stand at home.

    Raises:
        ValueError: The shaft at home does not pass through the taught trocar.
    """
    arm = cell.arms[name]
    home = _Home(arm)
    limits = arm.limits
    tilts = np.linspace(0.0, limits.cone, max(int(np.ceil(limits.cone / _STEP)), 2) + 1)
    turns = np.linspace(0.0, 2.0 * np.pi, _TURNS, endpoint=False)
    depths = np.linspace(limits.depth_slow, limits.depth_max, _DEPTHS)
    axis = _along_axis(arm, home, depths)
    q = np.repeat(axis[None], _TURNS, axis=0)  # (turn, depth, joint)
    alive = np.ones(q.shape[:2], dtype=bool)
    rows = []
    for tilt in tilts:
        X = home.poses(tilt, turns, depths)
        q, solved = _solve(arm, X, q)
        alive = alive & solved
        margin, speed = _reserve(arm, home, q, X, depths)
        alive = alive & (margin.min(axis=-1) > 0.0) & (speed > _SLOW)
        rows.append((alive, margin, speed, q))
    reached = np.array([row[0] for row in rows])
    margins = np.where(reached[..., None], np.array([row[1] for row in rows]), np.nan)
    speeds = np.where(reached, np.array([row[2] for row in rows]), np.nan)
    joints = np.array([row[3] for row in rows])
    clearance, nearest, distance = _clearances(cell, name, joints, reached)
    least = np.nanmin(margins, axis=(0, 1, 2))
    return Reach(
        arm=name,
        tilts=tilts,
        turns=turns,
        depths=depths,
        q=joints,
        reached=reached,
        margin=margins.min(axis=-1),
        speed=speeds,
        clearance=clearance,
        nearest=nearest,
        nearest_joint=arm.robot.joint_names[int(np.argmin(least))],
        distance=distance,
    )


class _Home:
    """The shaft at home: axis, orientation and trocar in B."""

    def __init__(self, arm: Arm) -> None:
        X = np.asarray(arm.chain.forward(arm.robot.home))
        self.R, self.p_FTip = X[:3, :3], np.asarray(arm.tool.p_FTip)
        self.s = self.R @ np.asarray(arm.tool.s_F)
        self.p_BRcm = np.asarray(arm.trocar.p_BRcm)
        tip = self.R @ self.p_FTip + X[:3, 3]
        self.depth = float(self.s @ (tip - self.p_BRcm))
        off = float(np.linalg.norm(tip - self.p_BRcm - self.depth * self.s))
        if off > HOME_MISS or self.depth <= 0.0:
            raise ValueError(
                f"arm {arm.name}: at home the shaft passes {1e3 * off:.1f} mm beside its trocar "
                f"and the tip is {1e3 * self.depth:.0f} mm behind it; allowed are "
                f"{1e3 * HOME_MISS:.0f} mm, and a tip inside. Teach the trocar anew "
                f"(calibration/trocar_{arm.name}.yaml), or give the arm another home in cell.yaml"
            )
        self.R_BRcm = np.asarray(rcm_frame(self.s, self.p_BRcm))[:3, :3]

    def poses(self, tilt: float, turns: FloatArray, depths: FloatArray) -> FloatArray:
        """Flange poses (m, k, 4, 4) in B with the shaft tilted, without roll."""
        X = np.zeros((len(turns), len(depths), 4, 4))
        for j, turn in enumerate(turns):
            axis = self.R_BRcm @ np.array([-np.sin(turn), np.cos(turn), 0.0])
            swing = axis_angle_to_matrix(axis, tilt)
            R = swing @ self.R
            X[j, :, :3, :3] = R
            X[j, :, :3, 3] = self.p_BRcm + np.outer(depths, swing @ self.s) - R @ self.p_FTip
        X[..., 3, 3] = 1.0
        return X


def _along_axis(arm: Arm, home: _Home, depths: FloatArray) -> FloatArray:
    """Joints (k, n) with the tip on the home axis, in small steps from the home depth."""
    q = np.empty((len(depths), arm.chain.dof))
    for k, depth in enumerate(depths):
        q[k] = np.asarray(arm.robot.home)
        for part in np.linspace(home.depth, depth, 8)[1:]:
            X = home.poses(0.0, np.zeros(1), np.array([part]))
            q[k] = _solve(arm, X, q[None, None, k])[0][0, 0]
    return q


def _solve(arm: Arm, X: FloatArray, start: FloatArray) -> tuple[FloatArray, np.ndarray]:
    """Newton's method for all poses (m, k, 4, 4) at once, near the joints (m, k, n).

    The null space of a redundant arm goes towards the home posture, as under control.
    """
    shape, n = start.shape[:2], arm.chain.dof
    q, target = start.reshape(-1, n).copy(), X.reshape(-1, 4, 4)
    home = np.asarray(arm.robot.home)
    error = np.full((len(q), 6), np.inf)
    for _ in range(_NEWTON):
        here = np.asarray(arm.chain.forward_batch(q))
        turn = target[:, :3, :3] @ here[:, :3, :3].transpose(0, 2, 1)
        w = 0.5 * np.stack(
            [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0],
             turn[:, 1, 0] - turn[:, 0, 1]], axis=1)  # fmt: skip
        error = np.concatenate([target[:, :3, 3] - here[:, :3, 3], w], axis=1)
        if np.abs(error).max() < _SOLVED:
            break
        J = np.asarray(arm.chain.jacobian_batch(q))
        inverse = np.linalg.pinv(J)
        step = np.einsum("ijk,ik->ij", inverse, error)
        if n > 6:
            pull = 0.2 * (home - q)
            step += pull - np.einsum("ijk,ikl,il->ij", inverse, J, pull)
        q += np.clip(step, -0.3, 0.3)
    solved = np.abs(error).max(axis=1) < 1e-5
    solved &= np.abs(q - start.reshape(-1, n)).max(axis=1) < _JUMP
    q = np.where(solved[:, None], q, start.reshape(-1, n))
    return q.reshape(*shape, n), solved.reshape(shape)


def _reserve(
    arm: Arm, home: _Home, q: FloatArray, X: FloatArray, depths: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Distances to the joints' limits (m, k, n) [rad], and the largest tip speed (m, k) [m/s]."""
    robot = arm.robot
    margin = np.minimum(q - np.asarray(robot.position_min), np.asarray(robot.position_max) - q)
    J = np.asarray(arm.chain.jacobian_batch(q.reshape(-1, q.shape[-1])))
    s = X[..., :3, :3] @ np.asarray(arm.tool.s_F)
    # Flange twist for a tip velocity v with the shaft through the trocar (control_law.md).
    omega = skew(s) / depths[None, :, None, None]  # omega = s x v / L
    linear = s[..., :, None] * s[..., None, :] - skew(X[..., :3, 3] - home.p_BRcm) @ omega
    twist = np.concatenate([linear, omega], axis=-2).reshape(-1, 6, 3)
    rates = np.linalg.pinv(J) @ twist
    fastest = np.asarray(robot.velocity) / np.maximum(np.linalg.norm(rates, axis=-1), 1e-9)
    return margin, fastest.min(axis=-1).reshape(q.shape[:2])


def _clearances(
    cell: Cell, name: str, q: FloatArray, reached: np.ndarray
) -> tuple[FloatArray, tuple[str, str], float]:
    clearance = np.where(reached, np.inf, np.nan)
    setup = clearance_setup(cell, name)
    if setup is None:
        return clearance, ("", ""), 0.0
    others = []
    for shape in setup.others:
        home = np.asarray(cell.arms[shape.name].robot.home)
        others.append(OtherArm(home, np.zeros_like(home)))
    least, nearest = np.inf, ("", "")
    for index in np.argwhere(reached):
        at = tuple(index)
        distance, own, other = setup.closest(q[at], others)
        clearance[at] = distance
        if distance < least:
            least, nearest = distance, (own, other)
    return clearance, nearest, setup.distance
