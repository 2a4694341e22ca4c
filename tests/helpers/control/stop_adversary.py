"""Everything that may stop an arm, drawn within the stated ranges: a plant with its own kinematics.

It shares no code with the controller. All drawn stops of one state run at once. Half of them are
aimed: their joints brake so that tip or shaft go as far as they can in a drawn direction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import surg_core
from helpers.control import dh

Array = NDArray[np.float64]
STEP = 0.001
"""Time of one step of the plant [s]."""
T = 0.002
"""Time from one command to the next [s]."""
EVERY = 4
"""Steps from one look at tip and shaft to the next."""


@dataclass(frozen=True)
class Ranges:
    """What the arm and its link may do, as their files state it."""

    lag: float  # [s] most delay, and most lag of a joint
    dead_man: float  # [s]
    lead: float  # [rad/s^2] of the leading joint in the link's stop
    least: Array  # (n,) [rad/s^2] deceleration of each joint
    most: Array  # (n,)

    @classmethod
    def of(cls, robot: surg_core.RobotConfig) -> Ranges:
        """As robot and link state them."""
        t, a = robot.tuning, np.asarray(robot.acceleration)
        lead = t.stop_deceleration
        return cls(t.link_lag, t.dead_man, lead, t.braking_least * a, t.braking_most * a)


@dataclass(frozen=True)
class Stopping:
    """A state in which an arm is stopped."""

    q: Array  # (n,) [rad]
    qd: Array  # (n,) [rad/s]
    sent: Array  # (k, n) [rad/s] commands, the newest first, 2 ms apart
    p_BRcm: Array
    bound: tuple[float, float]  # what the controller says of tip and shaft [m]


def tip_and_shaft(arm: surg_core.Arm, q: Array) -> tuple[Array, Array]:
    """Tip (k, 3) [m] and unit shaft (k, 3) of joints (k, n), by the makers' own parameters."""
    six = q.shape[1] == 6
    k = len(q)
    R = np.broadcast_to(np.diag([-1.0, -1.0, 1.0]) if six else np.eye(3), (k, 3, 3))
    p = np.zeros((k, 3))
    for i in range(q.shape[1]):
        c, s, o = np.cos(q[:, i]), np.sin(q[:, i]), np.zeros(k)
        if six:
            d, a, alpha = dh.UR5E[i]
            ca, sa = np.cos(alpha), np.sin(alpha)
            turn = [[c, -s * ca, s * sa], [s, c * ca, -c * sa], [o, o + sa, o + ca]]
            step = [a * c, a * s, o + d]
        else:
            a, d, alpha = dh.PANDA[i]
            ca, sa = np.cos(alpha), np.sin(alpha)
            turn = [[c, -s, o], [s * ca, c * ca, o - sa], [s * sa, c * sa, o + ca]]
            step = [o + a, o - d * sa, o + d * ca]
        p = p + np.einsum("kij,jk->ki", R, np.array(step))
        R = np.einsum("kij,jlk->kil", R, np.array(turn))
    if not six:
        p = p + dh.PANDA_FLANGE * R[:, :, 2]
    return p + R @ np.asarray(arm.tool.p_FTip), R @ np.asarray(arm.tool.s_F)


def off_pivot(tip: Array, s: Array, p_BRcm: Array) -> Array:
    """Distance of the shafts' lines from a point (k,) [m]."""
    away = tip - p_BRcm
    return np.linalg.norm(away - np.sum(away * s, axis=1)[:, None] * s, axis=1)


def _corners(rng: np.random.Generator, low: Array, high: Array, k: int) -> Array:
    """(k, n) values: two in three at the ends of their ranges, the others anywhere."""
    share = rng.random((k, len(low)))
    return low + np.where(rng.random((k, 1)) < 0.67, np.round(share), share) * (high - low)


def _worst_brakes(
    rng: np.random.Generator, arm: surg_core.Arm, state: Stopping, ranges: Ranges, k: int
) -> Array:
    """(k, n) decelerations that drive shaft or tip as far as they can in k drawn directions."""
    n, h = len(state.q), 1e-6
    tip, s = tip_and_shaft(arm, np.vstack([state.q, state.q + h * np.eye(n)]))
    near = tip - np.sum((tip - state.p_BRcm) * s, axis=1)[:, None] * s
    moved = np.where(rng.random((k, 1, 1)) < 0.5, (tip[1:] - tip[0]) / h, (near[1:] - near[0]) / h)
    pull = np.einsum("kni,ki->kn", moved, rng.normal(size=(k, 3))) * state.sent[0]
    return np.where(pull > 0, ranges.least, ranges.most)


@dataclass
class _Draw:
    """What happens in k stops."""

    delay: Array  # (k,) [s]
    lags: Array  # (k, n) [s]
    last: Array  # (k,) periods ago: the last command that arrives
    begin: Array  # (k,) [s] when link or robot begin to brake
    brakes: Array  # (k, n) [rad/s^2] of the joints that brake by themselves
    together: Array  # (k,) whether they brake along their path instead
    softness: Array  # (k,) 0: as hard as stated, 1: as softly


def _draw(
    arm: surg_core.Arm, state: Stopping, ranges: Ranges, k: int, rng: np.random.Generator
) -> _Draw:
    n, aimed = len(state.q), k // 2
    delay = ranges.lag * np.clip(rng.uniform(-0.5, 1.5, k), 0, 1)
    lags = _corners(rng, np.full(n, 1e-4), np.full(n, ranges.lag), k)
    lags = np.where(rng.random((k, 1)) < 0.3, lags[:, :1], lags)
    last = np.where(rng.random(k) < 0.6, 0, np.floor(rng.random(k) * (delay / T + 1e-9)))
    silent = delay - last * T + ranges.dead_man
    sooner = np.clip(rng.uniform(-0.2, 1.2, k), 0, 1) * silent
    begin = np.where(rng.random(k) < 0.5, sooner, silent)
    begin[:aimed] = np.where(rng.random(aimed) < 0.7, silent[:aimed], begin[:aimed])
    brakes = _corners(rng, ranges.least, ranges.most, k)
    brakes[:aimed] = _worst_brakes(rng, arm, state, ranges, aimed)
    together = rng.random(k) < 0.3
    together[:aimed] = False
    softness = np.clip(1.5 * rng.random(k), 0, 1)
    return _Draw(delay, lags, last, begin, brakes, together, softness)


def _along_the_path(qd: Array, ranges: Ranges, softness: Array) -> Array:
    """(k, n) decelerations with which all joints of an arm come to rest at one time."""
    fast = np.abs(qd)
    slowest = np.maximum((fast / ranges.least).max(1), fast.max(1) / ranges.lead)
    quickest = (fast / ranges.most).max(1)
    time = quickest + softness * (slowest - quickest)
    return np.asarray(fast / np.maximum(time, 1e-9)[:, None])


def worst(
    arm: surg_core.Arm, state: Stopping, ranges: Ranges, k: int, rng: np.random.Generator
) -> tuple[float, float]:
    """The farthest that the tip went, and the shaft from the trocar [m], in k drawn stops."""
    draw = _draw(arm, state, ranges, k, rng)
    q, qd = np.tile(state.q, (k, 1)), np.tile(state.qd, (k, 1))
    (tip0,), _ = tip_and_shaft(arm, state.q[None])
    most = np.zeros(2)
    own, brakes_now = draw.brakes.copy(), np.zeros(k, dtype=bool)
    keep = np.exp(-STEP / draw.lags)
    for step in range(4000):
        t = step * STEP
        begins = (t >= draw.begin) & ~brakes_now
        if begins.any():
            path = begins & draw.together
            own[path] = _along_the_path(qd[path], ranges, draw.softness[path])
            brakes_now |= begins
        index = np.maximum(np.ceil((draw.delay - t) / T - 1e-9), draw.last)
        u = state.sent[np.clip(index, 0, len(state.sent) - 1).astype(int)]
        free, way = u + (qd - u) * keep, STEP * u + (qd - u) * draw.lags * (1 - keep)
        left = np.minimum(np.abs(qd) / np.maximum(own, 1e-12), STEP)
        slower = np.sign(qd) * np.maximum(np.abs(qd) - own * STEP, 0.0)
        braked = np.sign(qd) * (np.abs(qd) * left - 0.5 * own * left**2)
        q = q + np.where(brakes_now[:, None], braked, way)
        qd = np.where(brakes_now[:, None], slower, free)
        rests = bool(brakes_now.all()) and not np.any(qd)
        if step % EVERY == EVERY - 1 or rests:
            tip, s = tip_and_shaft(arm, q)
            far = np.linalg.norm(tip - tip0, axis=1).max(), off_pivot(tip, s, state.p_BRcm).max()
            most = np.maximum(most, far)
        if rests:
            return float(most[0]), float(most[1])
    raise AssertionError("an arm that never comes to rest")
