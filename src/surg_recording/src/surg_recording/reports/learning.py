"""Compares a learned policy's roll-outs with the demonstrations.

Entries are those of ``trials.describe``, so that every number is computed in one way.
docs/guide/learning.md and docs/guide/run.md define them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from surg_recording.episode import episode_reader
from surg_recording.episode.episode_reader import Episode
from surg_recording.episode.verdicts import verdict
from surg_recording.metrics import unsafe_commands
from surg_recording.reports import trials

Entry = Mapping[str, Any]

OF_THE_WIRE = ("rejected", "clipped", "late", "obs_age_ms", "round_trip_ms")
"""Counts and times of a roll-out from the model server; None if it did not report them."""


def roll_out(entry: Entry, served: Mapping[str, Any], recorded: Episode | None) -> dict[str, Any]:
    """One entry of ``rollouts`` from ``trials.describe``, the server's counts and the recording."""
    rcm = entry["rcm_kinematic_mm"] or {}
    smoothness = entry["smoothness"] or {}
    return {
        "seed": entry["seed"],
        "success": entry["success"],
        "reason": entry["failure_reason"] or "",
        "phase": entry["phase"],
        "played": entry["played"],
        "duration_s": entry["duration_s"],
        "rcm_mean_mm": rcm.get("mean"),
        "rcm_max_mm": rcm.get("max"),
        "sparc": smoothness.get("sparc"),
        "ldlj": smoothness.get("ldlj"),
        **{name: served.get(name) for name in OF_THE_WIRE},
        "unsafe": None if recorded is None else look(recorded),
        "state_hash": entry["state_hash"],
    }


def look(recorded: Episode) -> dict[str, Any]:
    """Unsafe commands of all arms of a recording: number of cycles, and commands by rule."""
    rules: Counter[str] = Counter()
    for arm in recorded.arms:
        for rule in unsafe_commands.examine(recorded, arm):
            rules[rule.name] += rule.cycles
    cycles = sum(len(recorded.cycle(arm)) for arm in recorded.arms)
    return {"cycles": cycles, "commands": rules.total(), "rules": dict(rules)}


def demonstration(folder: Path) -> dict[str, Any]:
    """The entry of a demonstration's folder; an EpisodeError if it cannot be read."""
    recorded = episode_reader.read(folder)
    run = recorded.manifest.get("run") or {}
    judged = verdict(recorded.manifest)
    ticks = (recorded.manifest.get("sim") or {}).get("sim_time_s") or 0.0
    outcome = trials.TrialOutcome(
        judged.success, judged.reason, "", float(ticks), outcome=judged.outcome
    )
    return trials.describe(run["seed"], run["setting"], run["law"], outcome, recorded)


def summarise(
    rollouts: Sequence[Entry], shown: Sequence[Entry], info: Mapping[str, Any], least: int
) -> dict[str, Any]:
    """The dictionary of ``summary.json``; ``info`` is copied.

    ``ok``: every roll-out was played to its end, at least ``least`` succeeded, and no command was
    unsafe. ``shown`` are entries of demonstrations, to compare with.
    """
    rate = trials.success_rate([e["success"] for e in rollouts])
    reasons = [
        f"roll-out of seed {e['seed']} was not played to its end: {e['reason']}"
        for e in rollouts
        if not e["played"]
    ]
    looked = [e["unsafe"] for e in rollouts if e["unsafe"] is not None]
    commands = sum(each["commands"] for each in looked)
    if len(looked) < len(rollouts):
        reasons.append(f"{len(rollouts) - len(looked)} roll-outs have no recording to look at")
    if commands:
        reasons.append(f"{commands} unsafe commands (by rule: key 'unsafe')")
    if rate["k"] < least:
        reasons.append(f"{rate['k']} of {rate['n']} roll-outs succeeded, at least {least} were due")
    rules: Counter[str] = Counter()
    for each in looked:
        rules.update(each["rules"])
    return {
        "ok": not reasons,
        "reasons": reasons,
        **info,
        "success_rate": rate,
        "unsafe_commands": commands,
        "unsafe": {"cycles": sum(each["cycles"] for each in looked), "rules": dict(rules)},
        "rcm_max_mm": spread(rollouts, "rcm_max_mm"),
        "rcm_mean_mm": spread(rollouts, "rcm_mean_mm"),
        "smoothness": {
            name: {
                "rollouts": spread(rollouts, name),
                "demonstrations": spread([e["smoothness"] or {} for e in shown], name),
            }
            for name in ("sparc", "ldlj")
        },
        **{name: _total(rollouts, name) for name in ("rejected", "clipped", "late")},
        "obs_age_ms": _percentiles(rollouts, "obs_age_ms"),
        "round_trip_ms": _percentiles(rollouts, "round_trip_ms"),
        "rollouts": [dict(e) for e in rollouts],
    }


def spread(entries: Sequence[Entry], name: str) -> dict[str, float | int | None]:
    """Count, minimum, median and maximum of one number over the entries that have it."""
    return trials.spread(trials.values(entries, name))


def _total(entries: Sequence[Entry], name: str) -> int | None:
    numbers = [e[name] for e in entries if e[name] is not None]
    return sum(numbers) if numbers else None


def _percentiles(entries: Sequence[Entry], name: str) -> dict[str, float | None]:
    """Median of the roll-outs' medians, and the largest of their 99th percentiles."""
    middle, high = trials.values(entries, name, "p50"), trials.values(entries, name, "p99")
    return {"p50": float(np.median(middle)) if middle else None, "p99": max(high, default=None)}
