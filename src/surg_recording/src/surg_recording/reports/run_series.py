"""Time series of a run, in one frame and on one time axis."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from surg_core import WristGeometry
from surg_core.contract import SECOND_NS, STREAMS
from surg_core.transforms import rotate, virtual_tip
from surg_core.wrist_joints import tip_of_joints
from surg_recording import metrics
from surg_recording.episode.checked.shaft_ends import shaft_ends, wrist_of
from surg_recording.episode.episode_reader import Episode
from surg_recording.episode.table import Table
from surg_recording.recording_errors import EpisodeError, NoMotionError

Array = npt.NDArray[np.float64]

HELD_SPEED = 0.5e-3
"""Set-point speed below which the arm counts as standing still [m/s]."""
CAUSE_WITHIN = 0.5
"""[s] The first reason that the arm reports this soon after a refusal is taken for its cause."""
HELD_INPUT = 1e-3
"""Diagonal of the input's bounding box above which a standing arm counts as held [m]."""


@dataclasses.dataclass(frozen=True)
class Run:
    """Time series of one arm over its commanded window.

    Times are seconds from the window's first cycle; positions are in the arm's base frame [m].
    """

    arm: str
    t: Array
    cycle: Table
    tip: Array
    """(N, 3) measured tip."""
    s: Array
    """(N, 3) measured shaft axis."""
    p_rcm: Array
    """(N, 3) commanded pivot."""
    rcm_kinematic: Array
    """(N,) distance pivot to shaft line, from joint states."""
    t_input: Array
    """(M,) times of the input samples."""
    input: Array
    """(M, 3) input tip targets."""
    input_source: str
    t_truth: Array
    """(K,) times of the ground truth; K = 0 without a simulator."""
    truth: Table | None
    rcm_true: Array
    """(K,) distance from the undisturbed trocar to the true shaft axis."""
    tracking: metrics.Tracking | None
    """Tracking of the true tip, or of the measured one without a simulator."""
    tracking_measured: metrics.Tracking | None

    @property
    def fs(self) -> float:
        """Rate of the control loop [Hz]; a starved link may repeat a state."""
        steps = np.diff(self.t)
        return round(1.0 / float(np.median(steps[steps > 0])), 6)

    @property
    def t_executed(self) -> Array:
        """Times of ``executed``."""
        return self.t_truth if self.truth is not None else self.t

    @property
    def executed(self) -> Array:
        """Path of the tip: the simulator's ground truth if there is one, else as measured."""
        return self.truth.vector("tip") if self.truth is not None else self.tip

    @property
    def shaft(self) -> Array:
        """Shaft directions along ``executed``."""
        return self.truth.vector("axis") if self.truth is not None else self.s


def load(episode: Episode, arm: str | None = None) -> Run:
    """Read the commanded window of an episode; ``arm`` defaults to the first.

    Raises:
        NoMotionError: The arm accepted no servo command.
        EpisodeError: There is no such arm, or it has no cycles.
    """
    arm = chosen_arm(episode, arm)
    whole = episode.cycle(arm)
    commanded = np.flatnonzero(np.isin(whole["command"], STREAMS))
    if len(commanded) < 3:
        raise NoMotionError(
            f"{episode.folder}: {arm} accepted no servo command in {len(whole)} cycles"
        )
    cycle = whole.select(slice(int(commanded[0]), int(commanded[-1]) + 1))
    stamps = cycle["stamp_ns"]
    start = int(stamps[0])
    t = _seconds(stamps, start)
    tip, s, p_rcm = cycle.vector("p_tip"), cycle.vector("s"), cycle.vector("p_rcm")
    t_input, target, source = _input(episode, arm, cycle, start)
    truth = episode.ground_truth(arm)
    t_truth, true = np.zeros(0), np.zeros(0)
    if truth is not None:
        inside = (truth["stamp_ns"] >= stamps[0]) & (truth["stamp_ns"] <= stamps[-1])
        truth = truth.select(inside) if np.any(inside) else None
    if truth is not None:
        t_truth = _seconds(truth["stamp_ns"], start)
        true = metrics.rcm_deviation(
            truth.vector("shaft"), truth.vector("axis"), truth.vector("trocar")
        )
    measured = _track(t, tip, t_input, target)
    return Run(
        arm=arm,
        t=t,
        cycle=cycle,
        tip=tip,
        s=s,
        p_rcm=p_rcm,
        rcm_kinematic=metrics.rcm_deviation(shaft_ends(cycle), s, p_rcm),
        t_input=t_input,
        input=target,
        input_source=source,
        t_truth=t_truth,
        truth=truth,
        rcm_true=true,
        tracking=_track(t_truth, truth.vector("tip"), t_input, target) if truth else measured,
        tracking_measured=measured,
    )


def _track(t: Array, executed: Array, t_input: Array, target: Array) -> metrics.Tracking | None:
    try:
        return metrics.tracking(t, executed, t_input, target)
    except ValueError:  # too few samples: the limit on the tip error then fails
        return None


def _input(episode: Episode, arm: str, cycle: Table, start: int) -> tuple[Array, Array, str]:
    """Input tip targets in the base frame: times, positions, and their source."""
    name = f"command_{arm}"
    if name in episode.tables:
        t, p_R, topic = _targets(episode.table(name), cycle, start)
        if len(t) >= 2:
            # The rcm frame of the nearest cycle.
            stamps = _seconds(cycle["stamp_ns"], start)
            nearest = np.clip(np.searchsorted(stamps, t), 0, len(stamps) - 1)
            q_br = cycle.vector("q_br", "xyzw")[nearest]
            return t, cycle.vector("p_rcm")[nearest] + rotate(q_br, p_R), topic
    # Velocity commands have no target; the controller's goal is the best substitute.
    goal = cycle.vector("p_goal")
    return _seconds(cycle["stamp_ns"], start), goal, "cycle.p_goal"


def _targets(table: Table, cycle: Table, start: int) -> tuple[Array, Array, str]:
    """Times and rcm-frame positions of the pose stream that commanded this window."""
    counts = {t: int(np.sum(table["topic"] == t)) for t in ("servo_cp", "servo_jp")}
    topic = max(counts, key=lambda name: counts[name])
    rows = table.select(table["topic"] == topic)
    stamp = rows["stamp_ns"]
    if not len(rows) or np.any(stamp <= 0):
        return np.zeros(0), np.zeros((0, 3)), topic
    if topic == "servo_cp":
        position = rows.vector("", "xyz")
    else:
        position = _tips(rows, wrist_of(cycle))
    # Some samples outside the window, so that interpolation reaches its ends.
    first, last = cycle["stamp_ns"][0] - SECOND_NS, cycle["stamp_ns"][-1] + SECOND_NS
    good = np.isfinite(position).all(axis=1) & (stamp >= first) & (stamp <= last)
    order = np.flatnonzero(good)[np.argsort(stamp[good], kind="stable")]
    stamp, position = stamp[order], position[order]
    newest = np.append(np.diff(stamp) > 0, True) if len(stamp) else np.zeros(0, dtype=bool)
    return _seconds(stamp[newest], start), position[newest], topic


def _tips(rows: Table, wrist: WristGeometry | None) -> Array:
    """Tips (N, 3) of commanded joints in the rcm frame [m]; NaN where a joint is not known."""
    ends = virtual_tip(rows["yaw"], rows["pitch"], rows["insertion"])
    if wrist is None:
        return ends
    turns = [rows[name] for name in ("roll", "wrist_pitch", "wrist_yaw")]
    joints, tips = np.column_stack([ends, *turns]), np.full(ends.shape, np.nan)
    for row in np.flatnonzero(np.isfinite(joints).all(axis=1)):
        tips[row] = tip_of_joints(wrist, joints[row])[:3, 3]
    return tips


@dataclasses.dataclass(frozen=True)
class Refusals:
    """Pose commands that the arm refused while the motion was sent."""

    count: int
    sent: int
    first: float
    """Time of the first refusal from the window's first cycle [s]; NaN: none."""
    cause: str
    """What the arm reported then."""

    @property
    def accepted(self) -> float:
        """Share of the commands that the arm accepted."""
        return 1.0 - min(self.count / self.sent, 1.0) if self.sent else 1.0


def refusals(episode: Episode, run: Run) -> Refusals:
    """The refused commands from the run's first cycle to the end of the recording."""
    cycle = episode.cycle(run.arm)
    start = int(run.cycle["stamp_ns"][0])
    cycle = cycle.select(cycle["stamp_ns"] >= start)
    refused = cycle["refused"].astype(np.int64)
    rows = np.flatnonzero(np.diff(refused) > 0) + 1
    if not len(rows):
        return Refusals(0, 0, float("nan"), "")
    row = int(rows[0])
    soon = cycle["stamp_ns"] <= cycle["stamp_ns"][row] + CAUSE_WITHIN * SECOND_NS
    reported = [str(text) for text in cycle["reason"][soon][row:] if text]
    count = int(refused[-1] - refused[row - 1])
    taken = cycle["accepted"].astype(np.int64)
    return Refusals(
        count=count,
        sent=count + int(taken[-1] - taken[0]),
        first=(int(cycle["stamp_ns"][row]) - start) / SECOND_NS,
        cause=reported[0] if reported else "no reason reported",
    )


def longest_hold(run: Run) -> tuple[float, float]:
    """Duration and start [s] of the longest halt of the set-point while the input moved."""
    step = np.linalg.norm(np.diff(run.cycle.vector("p_set"), axis=0), axis=1)
    still = np.concatenate([[False], step < HELD_SPEED * np.maximum(np.diff(run.t), 1e-9), [False]])
    edges = np.flatnonzero(np.diff(still.astype(int)))
    target = metrics.interpolate(run.t, run.t_input, run.input)
    best = (0.0, 0.0)
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        duration = float(run.t[end] - run.t[begin])
        box = np.ptp(target[begin : end + 1], axis=0)
        if duration > best[0] and np.linalg.norm(box) > HELD_INPUT:
            best = (duration, float(run.t[begin]))
    return best


def chosen_arm(episode: Episode, arm: str | None) -> str:
    """Name of an arm, by default the first; an EpisodeError if there is no such arm."""
    if arm is None:
        if not episode.arms:
            raise EpisodeError(f"{episode.folder}: the manifest names no arm")
        return episode.arms[0]
    if arm not in episode.arms:
        raise EpisodeError(f"{episode.folder}: no arm {arm!r}; there are {', '.join(episode.arms)}")
    return arm


def _seconds(stamp_ns: npt.NDArray[np.int64], start_ns: int) -> Array:
    return np.asarray((stamp_ns - start_ns) * 1e-9)
