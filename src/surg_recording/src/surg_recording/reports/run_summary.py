"""From an episode to its numbers: ``summary.json`` and the series that the figures draw.

What each number means is said once, in docs/reference/report.md. Millimetres, degrees and
milliseconds are
used here and in the report only, and the key says so.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from surg_core.contract import ENABLED, FAULT, STREAMS
from surg_core.transforms import rotate, virtual_tip
from surg_recording import metrics
from surg_recording.episode.episode_reader import Episode, Table
from surg_recording.recording_errors import EpisodeError, NoMotionError

Array = npt.NDArray[np.float64]


PATH_CUTOFF_HZ = 3.0
SMOOTHNESS_PRESETS = ("reference", "paper")
HELD_S = 2.0
HELD_SPEED = 0.5e-3
"""A set-point slower than this stands still [m/s]."""
HELD_INPUT = 1e-3
"""… and is held when the input's box diagonal meanwhile is larger than this [m]."""
STILL_PATH = 1e-3
"""A motion shorter than this is none [m]."""
SETTING_BOUNDS: Mapping[str, Mapping[str, float]] = {"phantom": {"mean": 0.05, "max": 0.3}}
"""Kinematic RCM deviation in an episode of a task, by physical setting [mm]."""
ANY_SETTING: Mapping[str, float] = {"max": 1.0}
"""For a setting without bounds of its own [mm]."""


@dataclasses.dataclass(frozen=True)
class Limit:
    """One stated limit and what was measured against it."""

    name: str
    text: str
    measured: float | None
    bound: float
    at_least: bool = False
    judged: bool = True
    """False: stated for information, never a reason to fail."""

    @property
    def met(self) -> bool:
        """NaN and None do not meet a limit."""
        if self.measured is None or not math.isfinite(self.measured):
            return False
        return self.measured >= self.bound if self.at_least else self.measured <= self.bound

    def to_json(self) -> dict[str, Any]:
        """As it stands in summary.json."""
        return {
            "name": self.name,
            "text": self.text,
            "measured": self.measured,
            "bound": self.bound,
            "sense": "at least" if self.at_least else "at most",
            "judged": self.judged,
            "met": self.met,
        }


@dataclasses.dataclass(frozen=True)
class Run:
    """The series of one arm over the commanded window, ready to be measured and drawn.

    Times are seconds from the window's first cycle; positions are in the arm's base frame [m].
    """

    arm: str
    t: Array
    """(N,) cycle times."""
    cycle: Table
    """The N cycles of the window."""
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
    """The K rows of ground truth."""
    rcm_true: Array
    """(K,) distance from the undisturbed trocar to the true shaft axis."""
    tracking: metrics.Tracking | None
    """Of the true tip, or of the measured one without a simulator."""
    tracking_measured: metrics.Tracking | None

    @property
    def fs(self) -> float:
        """Rate of the loop [Hz], whose link may show a state more than once when starved."""
        steps = np.diff(self.t)
        return round(1.0 / float(np.median(steps[steps > 0])), 6)

    @property
    def t_executed(self) -> Array:
        """Times of ``executed``."""
        return self.t_truth if self.truth is not None else self.t

    @property
    def executed(self) -> Array:
        """The tip's path: the simulator's truth where there is one, else as measured."""
        return self.truth.vector("tip") if self.truth is not None else self.tip

    @property
    def shaft(self) -> Array:
        """Shaft directions along ``executed``."""
        return self.truth.vector("axis") if self.truth is not None else self.s


def load(episode: Episode, arm: str | None = None) -> Run:
    """Cut the commanded window out of an episode and bring everything into one frame.

    Args:
        episode: the recording.
        arm: default: the first arm.

    Raises:
        NoMotionError: no accepted servo command.
        EpisodeError: no such arm, no cycles.
    """
    arm = _arm(episode, arm)
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
    run = Run(
        arm=arm,
        t=t,
        cycle=cycle,
        tip=tip,
        s=s,
        p_rcm=p_rcm,
        rcm_kinematic=metrics.rcm_deviation(tip, s, p_rcm),
        t_input=t_input,
        input=target,
        input_source=source,
        t_truth=t_truth,
        truth=truth,
        rcm_true=true,
        tracking=None,
        tracking_measured=None,
    )
    measured = _track(t, tip, t_input, target)
    return dataclasses.replace(
        run,
        tracking_measured=measured,
        tracking=measured
        if truth is None
        else _track(t_truth, truth.vector("tip"), t_input, target),
    )


def summarise(episode: Episode, arm: str | None = None, run: Run | None = None) -> dict[str, Any]:
    """The dictionary of ``summary.json``.

    Args:
        episode: the recording.
        arm: default: the first arm.
        run: the result of ``load``, when it is at hand.

    Returns:
        Numbers, verdict (``ok``), ``reasons`` and ``limits``. A recording without motion gives the
        same keys with None and says why.

    Raises:
        EpisodeError: no such arm, or files that cannot be read.
    """
    arm = _arm(episode, arm)
    manifest = episode.manifest
    reasons = _reasons_of_the_recording(episode, arm)
    if run is None:
        try:
            run = load(episode, arm)
        except NoMotionError:
            reasons.insert(0, f"no motion: {arm} accepted no servo command")
    info = manifest.get("run") or {}
    sim = manifest.get("sim") or {}
    result: dict[str, Any] = {
        "ok": False,
        "reasons": reasons,
        "robot": _robot(manifest, arm),
        "motion": info.get("motion"),
        "mode": info.get("mode"),
        "law": info.get("law"),
        "link": info.get("link"),
        "duration_s": None,
        "scale": info.get("scale"),
        **dict.fromkeys(_MEASURED),
        "deterministic": sim.get("deterministic"),
        "state_hash": sim.get("state_hash"),
        "versions": manifest.get("versions") or {},
        "arm": arm,
        "seed": info.get("seed"),
        "time": manifest.get("mode"),
        "limits": [],
        "counts": _counts(episode, arm),
    }
    if run is None:
        return result
    result.update(_measure(run, lockstep=manifest.get("mode") == "lockstep"))
    result["counts"]["window_cycles"] = len(run.t)
    limits = stated_limits(result, info)
    result["limits"] = [limit.to_json() for limit in limits]
    reasons += _reasons_of_the_motion(run, result)
    reasons += [
        f"{limit.text}: {_number(limit.measured)}, allowed"
        f" {'≥' if limit.at_least else '≤'} {limit.bound:g}"
        for limit in limits
        if limit.judged and not limit.met
    ]
    result["ok"] = not reasons
    return result


def stated_limits(result: Mapping[str, Any], info: Mapping[str, Any]) -> list[Limit]:
    """The limits a run is judged by, with what was measured.

    An episode of a task has limits on the pivot only: whether the task succeeded is not for the
    recording to say, and what the tip had to follow was a means to it.
    """
    if info.get("setting"):
        return [
            Limit(
                f"rcm_kinematic_{name}",
                f"kinematic RCM deviation, {name} [mm]",
                result["rcm_kinematic_mm"][name],
                bound,
            )
            for name, bound in SETTING_BOUNDS.get(info["setting"], ANY_SETTING).items()
        ]
    kinematic, true = result["rcm_kinematic_mm"], result["rcm_true_mm"]
    tip, path = result["tip_error_mm"], result["path_length_mm"]
    ratio = abs(path["executed"] / path["input"] - 1.0) * 100.0 if path["input"] else math.nan
    limits = [
        Limit("rcm_kinematic_mean", "kinematic RCM deviation, mean [mm]", kinematic["mean"], 0.03),
        Limit("rcm_kinematic_max", "kinematic RCM deviation, max [mm]", kinematic["max"], 0.3),
    ]
    if true is not None:
        limits.append(Limit("rcm_true_max", "true RCM deviation, max [mm]", true["max"], 0.5))
    limits += [
        Limit("tip_error_rms", "tip error, rms, lag removed [mm]", tip["rms"], 1.0),
        Limit("path_length", "executed path against input's, difference [%]", ratio, 3.0),
        Limit("enabled", "cycles enabled [%]", 100.0 * result["enabled_fraction"], 100.0, True),
        Limit("unscaled", "cycles unscaled [%]", 100.0 * result["unscaled_fraction"], 98.0, True),
        Limit(
            "shaft_sweep",
            "shaft sweep [deg]",
            result["shaft_sweep_deg"],
            20.0,
            at_least=True,
            judged=bool(info.get("full_motion", False)),
        ),
    ]
    return limits


# --- measuring ----------------------------------------------------------------------------------

_MEASURED = (
    *("rcm_kinematic_mm", "rcm_true_mm", "tip_error_mm", "tip_lag_ms", "path_length_mm"),
    *("shaft_sweep_deg", "enabled_fraction", "unscaled_fraction", "smoothness", "controller"),
    *("trocar", "tip_error_measured_mm", "input_source", "idle"),
)


def _measure(run: Run, lockstep: bool) -> dict[str, Any]:
    rate = (len(run.t) - 1) / run.t[-1] if run.t[-1] > 0 else math.nan
    fs = run.fs
    _, path_in = metrics.uniform(run.t, metrics.interpolate(run.t, run.t_input, run.input), fs)
    _, path_out = metrics.uniform(run.t_executed, run.executed, fs)
    cycle = run.cycle
    compute = metrics.percentiles(cycle["compute_us"], 50, 99)
    period = None
    if not lockstep:
        periods = cycle["period_us"][cycle["period_us"] > 0]
        p50, p99, worst = metrics.percentiles(periods, 50, 99, 100)
        period = {"p50": p50, "p99": p99, "max": worst}
    overruns = cycle["overruns"]
    return {
        "duration_s": float(run.t[-1]),
        "rcm_kinematic_mm": _statistics(run.rcm_kinematic * 1e3),
        "rcm_true_mm": None if run.truth is None else _statistics(run.rcm_true * 1e3),
        "tip_error_mm": _error(run.tracking),
        "tip_error_measured_mm": _error(run.tracking_measured),
        "tip_lag_ms": run.tracking.lag * 1e3 if run.tracking else None,
        "input_source": run.input_source,
        "path_length_mm": {
            "input": metrics.path_length(path_in, fs, PATH_CUTOFF_HZ) * 1e3,
            "executed": metrics.path_length(path_out, fs, PATH_CUTOFF_HZ) * 1e3,
        },
        "idle": _idle(metrics.idle(path_out, fs, cutoff=PATH_CUTOFF_HZ)),
        "shaft_sweep_deg": math.degrees(metrics.shaft_sweep(run.shaft)),
        "enabled_fraction": float(np.mean(cycle["state"] == ENABLED)),
        "unscaled_fraction": float(np.mean(cycle["scale"] >= 1.0 - 1e-9)),
        "smoothness": _smoothness(path_in, path_out, fs),
        "controller": {
            "rate_hz": float(rate),
            "compute_us": {"p50": compute[0], "p99": compute[1]},
            "period_us": period,
            "overruns": int(overruns[-1] - overruns[0]),
        },
        "trocar": None if run.truth is None else _trocar(run.truth),
    }


def _smoothness(path_in: Array, path_out: Array, fs: float) -> dict[str, Any]:
    """Of the executed motion by each preset, beside the input's; the first preset on top."""
    found: dict[str, Any] = {}
    for preset in SMOOTHNESS_PRESETS:
        executed = metrics.smoothness(path_out, fs, preset)
        given = metrics.smoothness(path_in, fs, preset)
        found[preset] = {
            "sparc": executed.sparc,
            "ldlj": executed.ldlj,
            "input": {"sparc": given.sparc, "ldlj": given.ldlj},
            "samples": executed.samples,
            "parameters": executed.preset.parameters(),
        }
    first = found[SMOOTHNESS_PRESETS[0]]
    return {
        "preset": SMOOTHNESS_PRESETS[0],
        "sparc": first["sparc"],
        "ldlj": first["ldlj"],
        "presets": found,
    }


def _idle(found: metrics.Idle) -> dict[str, float | int]:
    """Idle time of the executed motion, with what was called idle."""
    return {
        "s": found.seconds,
        "share": found.share,
        "pauses": found.pauses,
        "below_mm_per_s": found.below * 1e3,
        "at_least_s": found.at_least,
        "cutoff_hz": found.cutoff,
    }


def _trocar(truth: Table) -> dict[str, Any]:
    force = np.linalg.norm(truth.vector("force"), axis=1)
    moved = np.linalg.norm(truth.vector("trocar_loaded") - truth.vector("trocar"), axis=1) * 1e3
    return {
        "force_n": {"mean": float(np.mean(force)), "max": float(np.max(force))},
        "displacement_mm": {"mean": float(np.mean(moved)), "max": float(np.max(moved))},
    }


def _statistics(values: Array) -> dict[str, float]:
    """Mean, median, 95th percentile, maximum; NaN (and so a failed limit) if any sample is NaN."""
    if not np.all(np.isfinite(values)):
        return dict.fromkeys(("mean", "median", "p95", "max"), math.nan)
    median, p95, worst = metrics.percentiles(values, 50, 95, 100)
    return {"mean": float(np.mean(values)), "median": median, "p95": p95, "max": worst}


def _error(tracking: metrics.Tracking | None) -> dict[str, float | None]:
    if tracking is None:
        return {"rms": None, "max": None}
    return {"rms": tracking.rms * 1e3, "max": tracking.max * 1e3}


def _track(t: Array, executed: Array, t_input: Array, target: Array) -> metrics.Tracking | None:
    try:
        return metrics.tracking(t, executed, t_input, target)
    except ValueError:  # too few samples: the limit on the tip error then fails by itself
        return None


# --- the input ----------------------------------------------------------------------------------


def _input(episode: Episode, arm: str, cycle: Table, start: int) -> tuple[Array, Array, str]:
    """Input tip targets in the base frame: times, positions, where they were taken from."""
    name = f"command_{arm}"
    if name in episode.tables:
        table = episode.table(name)
        t, p_R, topic = _targets(table, cycle, start)
        if len(t) >= 2:
            # The rcm frame as the cycle nearest in time knew it.
            stamps = _seconds(cycle["stamp_ns"], start)
            nearest = np.clip(np.searchsorted(stamps, t), 0, len(stamps) - 1)
            q_br = cycle.vector("q_br", "xyzw")[nearest]
            return t, cycle.vector("p_rcm")[nearest] + rotate(q_br, p_R), topic
    # Velocity commands name no target: what the controller made of them is all there is.
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
        position = virtual_tip(rows["yaw"], rows["pitch"], rows["insertion"])
    # One sample either side of the window, so that interpolation reaches its ends.
    first, last = int(cycle["stamp_ns"][0]), int(cycle["stamp_ns"][-1])
    margin = 1_000_000_000
    good = np.isfinite(position).all(axis=1) & (stamp >= first - margin) & (stamp <= last + margin)
    stamp, position = stamp[good], position[good]
    order = np.argsort(stamp, kind="stable")
    stamp, position = stamp[order], position[order]
    newest = np.append(np.diff(stamp) > 0, True) if len(stamp) else np.zeros(0, dtype=bool)
    return _seconds(stamp[newest], start), position[newest], topic


# --- verdict ------------------------------------------------------------------------------------


def _reasons_of_the_recording(episode: Episode, arm: str) -> list[str]:
    manifest, reasons = episode.manifest, []
    sim = manifest.get("sim") or {}
    if sim.get("aborted"):
        reasons.append(f"the simulation was aborted: {sim['aborted']}")
    if not episode.complete:
        reasons.append(f"the recording is incomplete: {manifest.get('reason')}")
    if manifest.get("mode") == "lockstep":
        for name in (f"cycle_{arm}", f"ground_truth_{arm}"):
            missing = (manifest["tables"].get(name) or {}).get("missing_ticks")
            if missing:
                reasons.append(f"{name}: {missing} ticks are missing")
    cycle = episode.cycle(arm)
    faults = np.flatnonzero(cycle["state"] == FAULT)
    if faults.size:
        row = int(faults[0])
        when = (int(cycle["stamp_ns"][row]) - int(cycle["stamp_ns"][0])) * 1e-9
        reasons.append(f"FAULT after {when:.3f} s: {cycle['reason'][row] or 'no reason given'}")
    return reasons


def _reasons_of_the_motion(run: Run, result: Mapping[str, Any]) -> list[str]:
    reasons = []
    executed = result["path_length_mm"]["executed"]
    if executed < STILL_PATH * 1e3:
        reasons.append(f"the tip did not move: executed path {executed:.3f} mm")
    held, since = longest_hold(run)
    if held >= HELD_S:
        row = int(np.searchsorted(run.t, since + held / 2))
        why = run.cycle["limited_by"][row] or run.cycle["reason"][row] or "no reason given"
        reasons.append(
            f"the arm was held for {held:.2f} s from {since:.2f} s on while the input moved: {why}"
        )
    return reasons


def longest_hold(run: Run) -> tuple[float, float]:
    """Longest time the set-point stood still while the input moved.

    Returns:
        Its duration and its start [s]; (0, 0) when there was none.
    """
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


# --- small things -------------------------------------------------------------------------------


def _counts(episode: Episode, arm: str) -> dict[str, Any]:
    tables, videos = episode.manifest["tables"], episode.manifest["videos"]
    cycle = episode.cycle(arm)
    return {
        "cycles": len(cycle),
        "window_cycles": 0,
        "rows": {name: entry["rows"] for name, entry in tables.items()},
        "frames": {name: entry["frames"] for name, entry in videos.items()},
        "dropped": {name: entry["dropped"] for name, entry in {**tables, **videos}.items()},
        "commands_accepted": int(cycle["accepted"][-1]) if len(cycle) else 0,
        "commands_refused": int(cycle["refused"][-1]) if len(cycle) else 0,
    }


def _robot(manifest: Mapping[str, Any], arm: str) -> str | None:
    stated = (manifest.get("run") or {}).get("robot")
    if stated:
        return str(stated)
    arms = (manifest.get("cell") or {}).get("arms") or {}
    return ((arms.get(arm) or {}).get("robot") or {}).get("name")


def _arm(episode: Episode, arm: str | None) -> str:
    if arm is None:
        if not episode.arms:
            raise EpisodeError(f"{episode.folder}: the manifest names no arm")
        return episode.arms[0]
    if arm not in episode.arms:
        raise EpisodeError(f"{episode.folder}: no arm {arm!r}; there are {', '.join(episode.arms)}")
    return arm


def _seconds(stamp_ns: npt.NDArray[np.int64], start_ns: int) -> Array:
    return np.asarray((stamp_ns - start_ns) * 1e-9)


def _number(value: float | None) -> str:
    return "not measured" if value is None or not math.isfinite(value) else f"{value:.4g}"
