"""Groups episodes of any kind into conditions, measures them, and compares a reference set.

A *condition* is what its episodes have in common: task, physical setting, robot, control law, and
whether robot and patient were simulated. docs/guide/evaluation.md defines the numbers.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from surg_recording import metrics
from surg_recording.episode import episode_reader as episodes
from surg_recording.episode import integrity
from surg_recording.episode.checked import metric_tables
from surg_recording.episode.episode_reader import Episode
from surg_recording.episode.same_recording import KnownRecordings
from surg_recording.episode.selection import Selection, SelectionError
from surg_recording.episode.verdicts import verdict
from surg_recording.imports.arm_series import DEVIATION
from surg_recording.metrics import reference_sets
from surg_recording.metrics.confidence_intervals import spread, success_rate
from surg_recording.recording_errors import EpisodeError, words_of
from surg_recording.reports import run_summary, trials
from surg_recording.reports.run_series import chosen_arm

IDENTITY = ("task", "setting", "robot", "law", "source")
SIMULATION, REAL = "simulation", "real"
SETTING_ORDER = ("phantom", "ex_vivo", "in_vivo")

Progress = Callable[[float, str], None]


@dataclasses.dataclass(frozen=True)
class Metric:
    """One number per episode.

    Attributes:
        name: Key in ``summary.json`` and the tables.
        title: Name in the report.
        unit: Empty for a number without one.
        path: Keys from an episode's entry to the number; ``{preset}`` is the preset's name.
    """

    name: str
    title: str
    unit: str
    path: tuple[str, ...]

    @property
    def heading(self) -> str:
        """Title and unit."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title

    def values(self, entries: Iterable[Mapping[str, Any]], preset: str) -> list[float]:
        """The number of every entry that has it."""
        return trials.values(entries, *(key.format(preset=preset) for key in self.path))

    def value(self, entry: Mapping[str, Any], preset: str) -> float | None:
        """The number of one entry; None if it has none."""
        return next(iter(self.values([entry], preset)), None)


METRICS = (
    Metric("rcm_kinematic_mean_mm", "RCM mean", "mm", ("rcm_kinematic_mm", "mean")),
    Metric("rcm_kinematic_max_mm", "RCM max", "mm", ("rcm_kinematic_mm", "max")),
    Metric("rcm_true_mean_mm", "true RCM mean", "mm", ("rcm_true_mm", "mean")),
    Metric("rcm_true_max_mm", "true RCM max", "mm", ("rcm_true_mm", "max")),
    Metric("sparc", "SPARC", "", ("smoothness", "presets", "{preset}", "sparc")),
    Metric("ldlj", "LDLJ", "", ("smoothness", "presets", "{preset}", "ldlj")),
    Metric("path_length_mm", "path length", "mm", ("path_length_mm", "executed")),
    Metric("duration_s", "duration", "s", ("duration_s",)),
    Metric("idle_s", "idle time", "s", ("idle", "s")),
    Metric("trocar_force_max_n", "trocar force max", "N", ("trocar", "force_n", "max")),
)


@dataclasses.dataclass(frozen=True)
class LeftOut:
    """An episode that is in no condition."""

    folder: str
    reason: str


def measure(recorded: Episode, arm: str | None = None) -> dict[str, Any]:
    """The entry of an episode, of the first arm by default.

    Raises:
        EpisodeError: It is not as recorded, or without motion.
    """
    recorded = metric_tables.for_metrics(recorded, chosen_arm(recorded, arm))
    try:
        measured = run_summary.summarise(recorded, arm)
    except ValueError as problem:  # a metric was given what is no number
        raise EpisodeError(f"{recorded.folder}: {problem}") from problem
    if measured["duration_s"] is None:
        raise EpisodeError(f"{recorded.folder}: {measured['reasons'][0]}")
    manifest = recorded.manifest
    if DEVIATION in ((manifest.get("imported") or {}).get("not_measured") or ()):
        measured["rcm_kinematic_mm"] = None
    info, judged = manifest.get("run") or {}, verdict(manifest)
    return {
        "folder": str(recorded.folder),
        "task": manifest.get("task") or measured["motion"],
        "title": info.get("title"),
        "setting": info.get("setting"),
        "robot": measured["robot"],
        "law": measured["law"],
        "source": SIMULATION if manifest.get("sim") or measured["rcm_true_mm"] else REAL,
        "arm": measured["arm"],
        "seed": measured["seed"],
        "operator": info.get("operator") or manifest.get("operator"),
        "success": judged.success,
        "outcome": judged.outcome,
        "failure_reason": judged.reason or None,
        "judged_by": judged.by,
        "disagreement": judged.disagreement,
        "duration_s": measured["duration_s"],
        **trials.pick(measured),
        "complete": recorded.complete,
        "problem": manifest.get("reason"),
        "remarks": integrity.remarks(recorded),
        "state_hash": measured["state_hash"],
    }


def measure_all(
    folders: Sequence[Path],
    arm: str | None,
    incomplete: bool,
    progress: Progress,
    selection: Selection | None = None,
) -> tuple[list[dict[str, Any]], list[LeftOut]]:
    """Entries of many episodes (first arm by default), and what was left out, with reasons.

    Left out: not as recorded, without motion, incomplete (unless ``incomplete``), or the same
    recording a second time. Those that ``selection`` does not fit are skipped. ``progress`` is
    called with the fraction done in [0, 1] and the current folder.
    """
    entries: list[dict[str, Any]] = []
    left_out: list[LeftOut] = []
    known = KnownRecordings()
    for i, folder in enumerate(folders):
        progress(i / len(folders), f"{i + 1} of {len(folders)}, {folder}")
        try:
            recorded = episodes.read(folder)
            if selection is not None and not selection.matches(recorded):
                continue
            if not recorded.complete and not incomplete:
                reason = recorded.manifest.get("reason")
                raise EpisodeError(f"{folder}: incomplete recording: {reason}")
            entry = measure(recorded, arm)
            if (twin := known.twin(recorded)) is not None:
                raise EpisodeError(f"{folder}: {twin}")
        except SelectionError:
            raise
        except Exception as problem:  # one recording, not the evaluation
            left_out.append(LeftOut(str(folder), words_of(problem, folder)))
        else:
            known.add(recorded)
            entries.append(entry)
    return entries, left_out


def remarks(entries: Iterable[Mapping[str, Any]]) -> list[str]:
    """What a reader should be told: verdicts that disagree, no hashes."""
    told: dict[str, list[str]] = {}
    for entry in entries:
        found = list(entry.get("remarks") or [])
        if entry.get("disagreement"):
            found.append(f"verdicts disagree, the first counts: {entry['disagreement']}")
        for each in found:
            told.setdefault(each, []).append(entry["folder"])
    return [
        f"{folders[0]}: {words}"
        if len(folders) == 1
        else f"{len(folders)} episodes, first {folders[0]}: {words}"
        for words, folders in told.items()
    ]


def grouped(
    entries: Sequence[Mapping[str, Any]], names: Callable[[Any], Any] = lambda value: value
) -> dict[str, list[Mapping[str, Any]]]:
    """Episodes by condition; the label states what distinguishes the conditions.

    ``names`` turns an identifier of a label into words.
    """
    groups: dict[tuple[Any, ...], list[Mapping[str, Any]]] = {}
    for entry in entries:
        groups.setdefault(tuple(entry[key] for key in IDENTITY), []).append(entry)
    differing = [i for i in range(len(IDENTITY)) if len({identity[i] for identity in groups}) > 1]
    order = {name: i for i, name in enumerate(SETTING_ORDER)}

    def rank(identity: tuple[Any, ...]) -> tuple[Any, ...]:
        task, setting, robot, law, source = identity
        return str(task), str(robot), source, order.get(setting, len(order)), str(setting), str(law)

    return {
        _label([value and names(value) for value in identity], differing): groups[identity]
        for identity in sorted(groups, key=rank)
    }


def _label(identity: Sequence[Any], differing: Sequence[int]) -> str:
    """Setting first; without any difference the setting or else the task."""
    shown = sorted(differing, key=lambda i: (IDENTITY[i] != "setting", i))
    if not shown:
        named = dict(zip(IDENTITY, identity, strict=True))
        return str(named["setting"] or named["task"] or named["robot"] or "all episodes")
    return ", ".join(str(identity[i] or f"no {IDENTITY[i]}") for i in shown)


def summarise(
    entries: Sequence[Mapping[str, Any]],
    left_out: Sequence[LeftOut],
    preset: str,
    compared: Mapping[str, Any] | None,
    info: Mapping[str, Any],
) -> dict[str, Any]:
    """The dictionary of an evaluation's ``summary.json``.

    ``preset`` is that of the smoothness; ``compared`` comes from ``compare``; ``info`` is copied.
    """
    return {
        **info,
        "preset": metrics.PRESETS[preset].parameters(),
        "conditions": {
            label: _condition(group, preset) for label, group in grouped(entries).items()
        },
        "reference": compared,
        "episodes": [dict(entry) for entry in entries],
        "left_out": [dataclasses.asdict(each) for each in left_out],
    }


def _condition(entries: Sequence[Mapping[str, Any]], preset: str) -> dict[str, Any]:
    rate = success_rate([entry["success"] for entry in entries])
    return {
        **{key: entries[0][key] for key in IDENTITY},
        "title": entries[0].get("title"),
        "n": len(entries),
        "incomplete": sum(not entry["complete"] for entry in entries),
        "success_rate": rate if rate["n"] else None,
        **{metric.name: spread(metric.values(entries, preset)) for metric in METRICS},
    }


def compare(spec: str, preset: str, progress: Progress) -> dict[str, Any]:
    """Measure the reference set ``KIND:PATH``; a ReferenceSetError if that is impossible."""
    reference = reference_sets.load(spec)
    measured = []
    for i, motion in enumerate(reference.motions):
        progress(i / len(reference.motions), f"{reference.name}: {motion.name}")
        measured.append(reference_sets.measure(motion))
    return reference_sets.summarise(reference, measured, preset)
