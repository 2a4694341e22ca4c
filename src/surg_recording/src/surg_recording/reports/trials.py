"""Describes and summarises many episodes of one task.

A *condition* is what episodes have in common: the physical setting and the control law. Episodes of
one condition differ only in their seeds. docs/guide/run.md defines the numbers.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from surg_recording.episode.episode_reader import Episode
from surg_recording.episode.verdicts import Verdict
from surg_recording.metrics.confidence_intervals import success_rate
from surg_recording.reports import run_limits, run_summary


@dataclasses.dataclass(frozen=True)
class TrialOutcome:
    """How an episode ended.

    Attributes:
        success: By the task's own definition, from ground truth; None: it was not judged.
        reason: Why it was no success; empty for a success.
        phase: Phase of the task at the end.
        duration_s: Simulated time.
        played: False if a node or the policy died, or the recording broke.
        outcome: As `verdicts` defines it.
    """

    success: bool | None
    reason: str
    phase: str
    duration_s: float
    played: bool = True
    outcome: str = ""


def describe(
    seed: int, setting: str, law: str, outcome: TrialOutcome, recorded: Episode | None
) -> dict[str, Any]:
    """One entry of ``episodes`` in ``summary.json``; ``recorded`` None: no readable recording.

    The deviations at its top are the first arm's, the instrument's; ``arms`` has those of every
    arm. An arm that was never moved has None.
    """
    arms: dict[str, dict[str, Any]] = {}
    sim: Mapping[str, Any] = {}
    if recorded is not None:
        sim = recorded.manifest.get("sim") or {}
        arms = {arm: pick(run_summary.summarise(recorded, arm)) for arm in recorded.arms}
    first = next(iter(arms.values()), dict.fromkeys(_OF_AN_ARM))
    return {
        "seed": seed,
        "setting": setting,
        "law": law,
        "success": outcome.success,
        "outcome": outcome.outcome or Verdict(outcome.success).outcome,
        "failure_reason": None if outcome.success else outcome.reason,
        "phase": outcome.phase,
        "duration_s": outcome.duration_s,
        "played": outcome.played,
        **first,
        "arms": arms,
        "deterministic": sim.get("deterministic"),
        "state_hash": sim.get("state_hash"),
    }


_OF_AN_ARM = (
    *("rcm_kinematic_mm", "rcm_true_mm", "trocar", "smoothness", "path_length_mm", "idle"),
)


def pick(measured: Mapping[str, Any]) -> dict[str, Any]:
    """The part of ``run_summary.summarise`` that an entry holds."""
    entry = {name: measured[name] for name in _OF_AN_ARM}
    smoothness = entry["smoothness"]
    if smoothness is not None:
        entry["smoothness"] = {
            **{key: smoothness[key] for key in ("preset", "sparc", "ldlj")},
            "presets": {
                preset: {key: values[key] for key in ("sparc", "ldlj")}
                for preset, values in smoothness["presets"].items()
            },
        }
    return entry


def summarise(
    episodes: Sequence[Mapping[str, Any]], info: Mapping[str, Any], reasons: Iterable[str] = ()
) -> dict[str, Any]:
    """The dictionary of a run's ``summary.json``; ``info`` is copied, ``reasons`` are failures.

    ``ok``: every episode was played to its end and recorded, not that the task succeeded: a failure
    of the task is a result.
    """
    broken = [
        f"episode {i} (seed {e['seed']}, {e['setting']}): {e['failure_reason']}"
        for i, e in enumerate(episodes)
        if not e["played"]
    ]
    wrong = [*reasons, *broken]
    groups: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for e in episodes:
        groups.setdefault((e["setting"], e["law"]), []).append(e)
    settings = list(dict.fromkeys(e["setting"] for e in episodes))
    return {
        "ok": not wrong,
        "reasons": wrong,
        **info,
        "setting": settings[0] if len(settings) == 1 else settings,
        "success_rate": success_rate([e["success"] for e in episodes]),
        "conditions": [_condition(*key, group) for key, group in groups.items()],
        "episodes": [dict(e) for e in episodes],
    }


def _condition(setting: str, law: str, episodes: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Statistics of the episodes of one condition."""
    condition: dict[str, Any] = {
        "setting": setting,
        "law": law,
        "success_rate": success_rate([e["success"] for e in episodes]),
        "duration_s": spread([e["duration_s"] for e in episodes]),
    }
    for name in ("rcm_kinematic_mm", "rcm_true_mm"):
        condition[name] = {key: spread(values(episodes, name, key)) for key in ("mean", "max")}
    for name in ("force_n", "displacement_mm"):
        condition[f"trocar_{name}"] = spread(values(episodes, "trocar", name, "max"))
    for name in ("sparc", "ldlj"):
        condition[name] = spread(values(episodes, "smoothness", name))
    bounds = run_limits.SETTING_BOUNDS.get(setting, run_limits.ANY_SETTING)
    condition["bounds"] = []
    for name, value in bounds.items():
        worst = condition["rcm_kinematic_mm"][name]["max"]
        met = worst is not None and worst < value
        condition["bounds"].append({"metric": name, "value": value, "worst": worst, "met": met})
    return condition


def values(episodes: Iterable[Mapping[str, Any]], *path: str) -> list[float]:
    """One number of every episode that has it, by its path of keys in the entry."""
    numbers = []
    for episode in episodes:
        value: Any = episode
        for key in path:
            value = None if value is None else value.get(key)
        if isinstance(value, int | float) and math.isfinite(value):
            numbers.append(float(value))
    return numbers


def spread(numbers: Sequence[float]) -> dict[str, float | int | None]:
    """Count, minimum, median and maximum of one number per episode."""
    if not numbers:
        return {"n": 0, "min": None, "median": None, "max": None}
    low, high = min(numbers), max(numbers)
    return {"n": len(numbers), "min": low, "median": float(np.median(numbers)), "max": high}
