"""Counts unsafe commands in a recording, from its control cycles alone.

An independent check: it shares no code with the controller, its gate, or the model server's safety
controller. Positions, steps, speeds and deviations are computed from the rows (never from the
columns with the controller's own verdicts) and compared with the limits in the episode's manifest.
It counts control cycles, by rule.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from surg_core.contract import ENABLED, POSITION_STREAMS, STREAMS
from surg_recording.episode.checked.shaft_ends import shaft_ends
from surg_recording.episode.episode_reader import Episode
from surg_recording.episode.table import Table
from surg_recording.recording_errors import EpisodeError

Array = npt.NDArray[np.float64]

TOLERANCE = 1e-6
"""Relative; a limit met exactly is met."""
STOP_NS = 300_000_000
"""Longest ramp after an arm has left ENABLED [ns]."""
STILL = 1e-6
"""Joint velocity below which a joint stands still [rad/s]."""


@dataclasses.dataclass(frozen=True)
class Rule:
    """Result of one rule for the cycles of one arm.

    Attributes:
        name: Name of the rule.
        unit: Unit of ``worst`` and ``limit``.
        cycles: Number of cycles that break it.
        worst: Largest value, of the joint or axis nearest to its limit; None without cycles.
        limit: Its limit.
        first_ns: Stamp of the first cycle that breaks it, if any.
    """

    name: str
    unit: str
    cycles: int
    worst: float | None
    limit: float
    first_ns: int | None


def examine(episode: Episode, arm: str) -> list[Rule]:
    """Compare an arm's cycles with the manifest's limits; an EpisodeError if either is missing."""
    limits = _Limits(episode, arm)
    cycle = episode.cycle(arm)
    # A cycle without a new joint state repeats its stamp: the last one counts.
    stamps = cycle["stamp_ns"]
    cycle = cycle.select(np.flatnonzero(np.append(np.diff(stamps) > 0, True)))
    stamps = cycle["stamp_ns"]
    dt = np.diff(stamps) * 1e-9
    look = _Look(stamps)
    qd = cycle.joints("qd_command") if "qd_command0" in cycle else np.zeros((len(cycle), 0))
    bad = ~np.isfinite(qd).all(axis=1)
    rules = [look.mask("not finite", "1", bad, bad.astype(float), 0.0)]
    qd = np.nan_to_num(qd, nan=0.0, posinf=0.0, neginf=0.0)
    joint = limits.joint
    rules.append(look.bound("joint velocity", "rad/s", np.abs(qd), joint("velocity")))
    change = np.abs(np.diff(qd, axis=0)) / dt[:, None]
    rules.append(look.bound("joint acceleration", "rad/s^2", change, joint("acceleration"), 1))
    q = cycle.joints()
    low, high = joint("position_min"), joint("position_max")
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    rules.append(look.bound("joint position, from the middle", "rad", np.abs(q - middle), half))
    rules.append(_motion_while_stopped(look, cycle, qd))
    rules += _tip(look, cycle, dt, limits)
    deviation = _distance(cycle.vector("p_rcm"), shaft_ends(cycle), cycle.vector("s"))
    homed = cycle["homed"] == 1
    deviation = np.where(homed, deviation, 0.0)
    rules.append(look.bound("RCM deviation", "m", deviation[:, None], limits["rcm_error_fault"]))
    return rules


class _Limits:
    """Limits of an arm from the manifest."""

    def __init__(self, episode: Episode, arm: str) -> None:
        self._where = f"{episode.folder}/manifest.json"
        arms = (episode.manifest.get("cell") or {}).get("arms") or {}
        if arm not in arms:
            raise EpisodeError(f"{self._where}: no description of {arm}, so its limits are unknown")
        self._arm: Mapping[str, Any] = arms[arm]
        self._name = arm

    def __getitem__(self, name: str) -> float:
        limit = (self._arm.get("limits") or {}).get(name)
        if not isinstance(limit, int | float):
            raise EpisodeError(f"{self._where}: {self._name} has no limit '{name}'")
        return float(limit)

    def joint(self, name: str) -> Array:
        """A number for each joint, (n,)."""
        limits = ((self._arm.get("robot") or {}).get("joints") or {}).get(name)
        if not isinstance(limits, list):
            raise EpisodeError(f"{self._where}: the robot of {self._name} has no joints.{name}")
        return np.array(limits, dtype=np.float64)

    @property
    def jaw(self) -> tuple[float, float] | None:
        """Smallest and largest angle [rad]; None without jaws."""
        jaw = (self._arm.get("instrument") or {}).get("jaw")
        return (float(jaw["min"]), float(jaw["max"])) if jaw else None


class _Look:
    """Compares values of cycles with limits."""

    def __init__(self, stamps: npt.NDArray[np.int64]) -> None:
        self._stamps = stamps

    def bound(
        self, name: str, unit: str, values: Array, limit: Array | float, later: int = 0
    ) -> Rule:
        """Values (N, k) that must not exceed a limit or limits (k,).

        ``later``: cycle of the first value. A non-finite value breaks the rule.
        """
        limits = np.broadcast_to(np.asarray(limit, dtype=np.float64), values.shape[1:])
        broken = (~(values <= limits * (1.0 + TOLERANCE))).any(axis=1)
        if not values.size:
            return Rule(name, unit, 0, None, float(np.min(limits, initial=np.inf)), None)
        shares = np.where(np.isfinite(values), values / limits, np.inf)
        column = int(np.argmax(shares.max(axis=0)))
        return self.mask(name, unit, broken, values[:, column], float(limits[column]), later)

    def mask(
        self,
        name: str,
        unit: str,
        broken: npt.NDArray[np.bool_],
        values: Array,
        limit: float,
        later: int = 0,
    ) -> Rule:
        """A rule from the cycles that are known to break it."""
        where = np.flatnonzero(broken)
        first = int(self._stamps[later + where[0]]) if len(where) else None
        worst = float(np.max(values)) if len(values) else None
        return Rule(name, unit, len(where), worst, limit, first)


def _motion_while_stopped(look: _Look, cycle: Table, qd: Array) -> Rule:
    """Velocities sent to an arm that is not ENABLED, after its ramp must be over."""
    stamps, stopped = cycle["stamp_ns"], cycle["state"] != ENABLED
    fastest = np.max(np.abs(qd), axis=1, initial=0.0)
    row = np.arange(len(cycle))
    since = np.maximum.accumulate(np.where(stopped, -1, row))  # the last ENABLED cycle before
    # Before the first ENABLED cycle nothing can be ramping down.
    late = stopped & ((since < 0) | (stamps - stamps[np.maximum(since, 0)] > STOP_NS))
    shown = np.where(late, fastest, 0.0)
    return look.mask("motion while not enabled", "rad/s", shown > STILL, shown, STILL)


def _tip(look: _Look, cycle: Table, dt: Array, limits: _Limits) -> list[Rule]:
    """Set-point and goals of the tip, in the rcm frame, while a stream is followed."""
    R_BR = _matrices(cycle.vector("q_br", "xyzw"))
    to_R = np.transpose(R_BR, (0, 2, 1))

    def in_R(of: str) -> Array:
        p_R = to_R @ (shaft_ends(cycle, of) - cycle.vector("p_rcm"))[:, :, None]
        return np.asarray(p_R[:, :, 0])

    servo = np.isin(cycle["command"], STREAMS) & (cycle["homed"] == 1)
    p_set, goal = in_R("set"), in_R("goal")
    both = servo[1:] & servo[:-1]
    speed = np.where(both[:, None], np.abs(np.diff(p_set, axis=0)) / dt[:, None], 0.0)
    depth = np.linalg.norm(p_set, axis=1)
    lean = np.arctan2(np.linalg.norm(p_set[:, :2], axis=1), p_set[:, 2])
    shallow = np.where(servo, limits["depth_min"] - depth, 0.0)
    rules = [
        look.bound("speed of the tip's set-point", "m/s", speed, limits["tip_velocity"], 1),
        look.bound("depth", "m", np.where(servo, depth, 0.0)[:, None], limits["depth_max"]),
        look.mask("too shallow", "m", shallow > TOLERANCE, shallow, 0.0),
        look.bound("lean of the shaft", "rad", np.where(servo, lean, 0.0)[:, None], limits["cone"]),
    ]
    rules += _steps(look, cycle, goal, p_set, limits)
    if limits.jaw is not None:
        low, high = limits.jaw
        jaw = np.where(np.isfinite(cycle["jaw_set"]) & servo, cycle["jaw_set"], low)
        beyond = np.maximum(jaw - high, low - jaw)
        rules.append(look.mask("jaw beyond its range", "rad", beyond > TOLERANCE, beyond, 0.0))
    return rules


def _steps(look: _Look, cycle: Table, goal: Array, p_set: Array, limits: _Limits) -> list[Rule]:
    """Distance of an accepted goal from the previous one, or of a first one from the set-point."""
    stamps = cycle["stamp_ns"]
    taken = np.diff(cycle["accepted"], prepend=cycle["accepted"][:1]) > 0
    pose = np.isin(cycle["command"], POSITION_STREAMS) & (cycle["homed"] == 1)
    moved = (np.diff(goal, axis=0, prepend=goal[:1]) != 0.0).any(axis=1)
    moved |= np.diff(cycle["roll_goal"], prepend=cycle["roll_goal"][:1]) != 0.0
    rows = np.flatnonzero(taken & pose & moved)
    tip_excess, roll_excess = np.zeros(len(cycle)), np.zeros(len(cycle))
    for k, row in enumerate(rows.tolist()):
        begins = k == 0 or not pose[rows[k - 1] : row].all()
        last = (p_set if begins else goal)[row - 1]
        roll = cycle["roll_set" if begins else "roll_goal"][row - 1]
        age = 0.0 if begins else (stamps[row] - stamps[rows[k - 1]]) * 1e-9
        dt = min(age, limits["step_dt_max"])
        tip_step = float(np.linalg.norm(goal[row] - last))
        roll_step = abs(float(cycle["roll_goal"][row] - roll))
        tip_excess[row] = tip_step - (limits["tip_velocity"] * dt + limits["step_slack"])
        roll_excess[row] = roll_step - (limits["roll_velocity"] * dt + limits["step_roll_slack"])
    return [
        look.mask(f"step of the {name}'s goal, beyond what is allowed", unit, x > 1e-9, x, 0.0)
        for name, unit, x in (("tip", "m", tip_excess), ("roll", "rad", roll_excess))
    ]


def _distance(p: Array, on_line: Array, along: Array) -> Array:
    """Distances of points from lines, (N,)."""
    s = along / np.linalg.norm(along, axis=1, keepdims=True)
    d = p - on_line
    return np.asarray(np.linalg.norm(d - np.sum(d * s, axis=1, keepdims=True) * s, axis=1))


def _matrices(q: Array) -> Array:
    """Rotation matrices (N, 3, 3) of unit quaternions x, y, z, w."""
    x, y, z, w = q.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)
