"""Computes ``summary.json`` of a recorded run.

docs/reference/report.md defines every number. Only this module and the report use millimetres,
degrees and milliseconds; the keys name the unit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from surg_core.contract import ENABLED, FAULT
from surg_recording import metrics
from surg_recording.episode.episode_reader import Episode
from surg_recording.episode.table import Table
from surg_recording.metrics.path import IDLE_AT_LEAST, IDLE_BELOW
from surg_recording.recording_errors import NoMotionError
from surg_recording.reports.run_limits import stated_limits
from surg_recording.reports.run_series import (
    Refusals,
    Run,
    chosen_arm,
    load,
    longest_hold,
    refusals,
)

Array = npt.NDArray[np.float64]


PATH_CUTOFF_HZ = 3.0
"""Low-pass applied before path length and idle time are measured [Hz]."""
SMOOTHNESS_PRESETS = ("reference", "paper")
HELD_S = 2.0
"""Time for which an arm must be held to fail the run [s]."""
EXECUTED_SHARE = 0.99
"""Share of the commands that the arm must accept."""
STILL_PATH = 1e-3
"""Path length below which the tip has not moved [m]."""


def summarise(episode: Episode, arm: str | None = None, run: Run | None = None) -> dict[str, Any]:
    """The dictionary of ``summary.json``; ``run`` is the result of ``load``, if available.

    Numbers, verdict (``ok``), ``reasons`` and ``limits``. A recording without motion has the same
    keys with None, and the reason. An EpisodeError if a file cannot be read.
    """
    arm = chosen_arm(episode, arm)
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
        "commands_refused": None,
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
    refused = refusals(episode, run)
    result["commands_refused"] = refused.count
    if not info.get("setting"):
        reasons += _reasons_of_refusals(refused)
    result.update(_measure(run, lockstep=manifest.get("mode") == "lockstep"))
    result["counts"]["window_cycles"] = len(run.t)
    limits = stated_limits(result, info)
    result["limits"] = [limit.to_json() for limit in limits]
    reasons += _reasons_of_the_motion(run, result)
    reasons += [str(limit) for limit in limits if limit.judged and not limit.met]
    result["ok"] = not reasons
    return result


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
    idle = metrics.idle(path_out, fs, PATH_CUTOFF_HZ)
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
        "idle": {
            "s": idle.seconds,
            "share": idle.share,
            "pauses": idle.pauses,
            "below_mm_per_s": IDLE_BELOW * 1e3,
            "at_least_s": IDLE_AT_LEAST,
            "cutoff_hz": PATH_CUTOFF_HZ,
        },
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
    """Smoothness of executed and input motion by each preset; the first preset on top."""
    by_preset: dict[str, Any] = {}
    for preset in SMOOTHNESS_PRESETS:
        executed = metrics.smoothness(path_out, fs, preset)
        given = metrics.smoothness(path_in, fs, preset)
        by_preset[preset] = {
            "sparc": executed.sparc,
            "ldlj": executed.ldlj,
            "input": {"sparc": given.sparc, "ldlj": given.ldlj},
            "samples": executed.samples,
            "parameters": executed.preset.parameters(),
        }
    first = by_preset[SMOOTHNESS_PRESETS[0]]
    return {
        "preset": SMOOTHNESS_PRESETS[0],
        "sparc": first["sparc"],
        "ldlj": first["ldlj"],
        "presets": by_preset,
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


def _reasons_of_refusals(refused: Refusals) -> list[str]:
    if refused.accepted >= EXECUTED_SHARE:
        return []
    return [
        f"{100 * refused.accepted:.0f} % of the motion was executed: the arm refused "
        f"{refused.count} of {refused.sent} commands, first after {refused.first:.3f} s "
        f"({refused.cause})"
    ]


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


def _counts(episode: Episode, arm: str) -> dict[str, Any]:
    tables, videos = episode.manifest["tables"], episode.manifest["videos"]
    cycle = episode.cycle(arm)
    return {
        "cycles": len(cycle),
        "window_cycles": 0,
        "rows": {name: entry.get("rows") for name, entry in tables.items()},
        "frames": {name: entry.get("frames") for name, entry in videos.items()},
        "dropped": {name: entry.get("dropped", 0) for name, entry in {**tables, **videos}.items()},
        "commands_accepted": int(cycle["accepted"][-1]) if len(cycle) else 0,
        "commands_refused": int(cycle["refused"][-1]) if len(cycle) else 0,
    }


def _robot(manifest: Mapping[str, Any], arm: str) -> str | None:
    stated = (manifest.get("run") or {}).get("robot")
    if stated:
        return str(stated)
    arms = (manifest.get("cell") or {}).get("arms") or {}
    return ((arms.get(arm) or {}).get("robot") or {}).get("name")
