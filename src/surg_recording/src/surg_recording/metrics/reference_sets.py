"""Reference sets: recorded motions that a smoothness figure is compared with.

The command line names a set as KIND:PATH. ``jigsaws:DIR`` is a task of JIGSAWS, measured on
PSM1; ``motion:PATH`` a CSV file, or a folder of them, with the columns t_s, x_m, y_m, z_m.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from surg_core.reading.text_table import read_table
from surg_recording import metrics
from surg_recording.metrics import jigsaws
from surg_recording.metrics.confidence_intervals import spread
from surg_recording.metrics.reference_motion import Motion, ReferenceSet
from surg_recording.recording_errors import ReferenceSetError
from surg_recording.reports.run_summary import PATH_CUTOFF_HZ

MOTION_COLUMNS = ("t_s", "x_m", "y_m", "z_m")
SHORTEST_S = 2.0
"""Shorter motions are left out: too short at the metrics' 5 Hz."""

LONGEST_GAP_S = 0.2
"""A longer gap would be filled with a straight line, which is smooth by itself."""


def load(spec: str) -> ReferenceSet:
    """Read a reference set ``KIND:PATH``; a ReferenceSetError if nothing is readable."""
    kind, colon, path = spec.partition(":")
    if not colon or kind not in KINDS or not path:
        known = " or ".join(f"{name}:{what}" for name, (what, _) in KINDS.items())
        raise ReferenceSetError(f"reference {spec!r}: {known} is needed")
    return KINDS[kind][1](Path(path))


def measure(motion: Motion, presets: Sequence[str] = tuple(metrics.PRESETS)) -> dict[str, Any]:
    """Metrics of a motion as of an episode; a ValueError if its rate is below a preset's."""
    smoothness = {name: metrics.smoothness(motion.p, motion.fs, name) for name in presets}
    return {
        "name": motion.name,
        "skill": motion.skill,
        "duration_s": (len(motion.p) - 1) / motion.fs,
        "path_length_mm": {
            "executed": metrics.path_length(motion.p, motion.fs, PATH_CUTOFF_HZ) * 1e3
        },
        "idle": {"s": metrics.idle(motion.p, motion.fs, PATH_CUTOFF_HZ).seconds},
        "smoothness": {
            "presets": {name: {"sparc": s.sparc, "ldlj": s.ldlj} for name, s in smoothness.items()}
        },
    }


def summarise(
    reference: ReferenceSet, measured: Sequence[Mapping[str, Any]], preset: str
) -> dict[str, Any]:
    """``reference`` of an evaluation's ``summary.json``, from ``measure`` of each motion."""
    skills = [
        skill for skill in jigsaws.SKILLS.values() if any(m["skill"] == skill for m in measured)
    ]
    return {
        "name": reference.name,
        "source": reference.source,
        **_numbers(measured, preset),
        "by_skill": {
            skill: _numbers([m for m in measured if m["skill"] == skill], preset)
            for skill in skills
        },
        "left_out": list(reference.warnings),
        "each": [dict(m) for m in measured],
    }


def _numbers(measured: Sequence[Mapping[str, Any]], preset: str) -> dict[str, Any]:
    def of(pick: Callable[[Mapping[str, Any]], float]) -> dict[str, Any]:
        return spread([x for m in measured if math.isfinite(x := pick(m))])

    return {
        "trials": len(measured),
        "sparc": of(lambda m: m["smoothness"]["presets"][preset]["sparc"]),
        "ldlj": of(lambda m: m["smoothness"]["presets"][preset]["ldlj"]),
        "path_length_mm": of(lambda m: m["path_length_mm"]["executed"]),
        "duration_s": of(lambda m: m["duration_s"]),
        "idle_s": of(lambda m: m["idle"]["s"]),
    }


def from_motions(path: Path) -> ReferenceSet:
    """Tip motions in CSV files."""
    files = sorted(path.glob("*.csv")) if path.is_dir() else [path]
    if not files:
        raise ReferenceSetError(f"{path}: no .csv file in this folder")
    motions, warnings = [], []
    for file in files:
        try:
            motions.append(read_motion(file))
        except ReferenceSetError as problem:
            warnings.append(str(problem))
    if not motions:
        raise ReferenceSetError(warnings[0])
    name = motions[0].name if len(motions) == 1 else path.name
    return ReferenceSet(
        name.replace("_", " "),
        f"{len(motions)} recorded motion{'s' * (len(motions) != 1)} from CSV",
        tuple(motions),
        tuple(warnings),
    )


def read_motion(file: Path) -> Motion:
    """One CSV file with at least the columns t_s, x_m, y_m, z_m, on a grid of its median rate.

    Raises:
        ReferenceSetError: Missing file or column, a non-finite value, times that do not increase,
            or less than 2 s.
    """
    header, rows = read_table(file, ReferenceSetError)
    missing = [name for name in MOTION_COLUMNS if name not in header]
    if missing:
        raise ReferenceSetError(
            f"{file}: no column {', '.join(missing)}; {', '.join(MOTION_COLUMNS)} are needed"
        )
    values = np.array([[row.number(name) for name in MOTION_COLUMNS] for row in rows])
    values = values.reshape(-1, len(MOTION_COLUMNS))
    t, p = values[:, 0], values[:, 1:]
    for wrong, why in (
        (np.diff(t) <= 0, "t_s does not increase"),
        (np.diff(t) > LONGEST_GAP_S, f"{LONGEST_GAP_S:g} s without a sample before it"),
    ):
        if wrong.any():
            raise ReferenceSetError(f"{rows[int(np.argmax(wrong)) + 1].where}: {why}")
    duration = float(t[-1] - t[0]) if len(t) else 0.0
    if duration < SHORTEST_S:
        raise ReferenceSetError(
            f"{file}: lasts {duration:.2f} s, at least {SHORTEST_S:g} s are needed"
        )
    fs = 1.0 / float(np.median(np.diff(t)))
    return Motion(file.stem, fs, metrics.uniform(t, p, fs)[1])


KINDS: dict[str, tuple[str, Callable[[Path], ReferenceSet]]] = {
    "jigsaws": ("DIR", jigsaws.read),
    "motion": ("CSV_OR_DIR", from_motions),
}
"""Kind → name of its path in help texts, and its reader."""
