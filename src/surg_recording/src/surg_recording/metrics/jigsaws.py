"""Reads JIGSAWS: kinematics of exercises on a da Vinci.

The dataset (Y. Gao et al., "The JHU-ISI Gesture and Skill Assessment Working Set", M2CAI 2014)
needs registration and is never part of this project. A task's folder holds::

    Knot_Tying/kinematics/AllGestures/Knot_Tying_B001.txt    one trial: subject B, trial 1
    Knot_Tying/meta_file_Knot_Tying.txt                      skill and scores, one line per trial

A trial is text without a header: one line per sample at 30 Hz, 76 numbers. Four manipulators have
19 each: position [m] (3), rotation matrix row by row (9), linear velocity [m/s] (3), angular
velocity [rad/s] (3), gripper angle [rad] (1). Their order is master left, master right, slave left,
slave right. The slaves are the instruments: PSM1 is slave left.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from surg_recording.metrics._types import Array
from surg_recording.metrics.reference_motion import Motion, ReferenceSet
from surg_recording.recording_errors import ReferenceSetError

FS = 30.0
"""[Hz]"""
COLUMNS = 76
PSM1 = slice(38, 41)
SKILLS = {"N": "novice", "I": "intermediate", "E": "expert"}
"""By hours of practice, as the subjects stated them."""
SHORTEST = 60
"""Trials with fewer samples (2 s) are left out: too short at the metrics' 5 Hz."""

_PLACE = "kinematics/AllGestures"
_NAME = re.compile(r"^(?P<task>.+)_[A-Za-z]\d{3}$")


def read(folder: Path | str) -> ReferenceSet:
    """Read PSM1 of all trials of one task, by name; broken files are left out with a warning.

    ``folder`` is the task's, its ``kinematics/AllGestures``, or one with only one task in it.

    Raises:
        ReferenceSetError: No such folder, no trial in it, several tasks, or none can be read.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ReferenceSetError(f"{folder}: no such folder")
    files = sorted(folder.rglob(f"{_PLACE}/*.txt")) or sorted(folder.glob("*.txt"))
    named = [(file, match["task"]) for file in files if (match := _NAME.match(file.stem))]
    if not named:
        raise ReferenceSetError(
            f"{folder}: no JIGSAWS trial; a task's folder with {_PLACE}/<Task>_<Subject><nnn>.txt"
            " is needed"
        )
    tasks = sorted({task for _, task in named})
    if len(tasks) > 1:
        raise ReferenceSetError(
            f"{folder}: holds several tasks ({', '.join(tasks)}), which do not belong in one box;"
            f" name the folder of one, such as {folder / tasks[0]}"
        )
    warnings: list[str] = []
    skills = _skills(folder, named[0][0], tasks[0], warnings)
    motions = []
    for file, _ in named:
        try:
            samples = read_samples(file)
        except ReferenceSetError as problem:
            warnings.append(str(problem))
            continue
        motions.append(Motion(file.stem, FS, samples[:, PSM1], skills.get(file.stem)))
    if not motions:
        raise ReferenceSetError(f"{folder}: no trial can be read; the first: {warnings[0]}")
    name = f"JIGSAWS {tasks[0].replace('_', ' ')}"
    source = f"{name}, PSM1 (slave left), positions at {FS:g} Hz"
    return ReferenceSet(name, source, tuple(motions), tuple(warnings))


def read_samples(file: Path) -> Array:
    """The samples of one trial, (N, 76); a ReferenceSetError with file and line if malformed."""
    rows = [
        _numbers(file, number, line.split())
        for number, line in enumerate(_lines(file), start=1)
        if line.strip()
    ]
    if not rows:
        raise ReferenceSetError(f"{file}: empty")
    if len(rows) < SHORTEST:
        raise ReferenceSetError(
            f"{file}: {len(rows)} samples, at least {SHORTEST} ({SHORTEST / FS:g} s) are needed"
        )
    return np.array(rows)


def _numbers(file: Path, line: int, fields: Sequence[str]) -> list[float]:
    try:
        if len(fields) != COLUMNS:
            raise ValueError(f"{len(fields)} numbers, {COLUMNS} are needed")
        values = [float(field) for field in fields]
        if not all(map(math.isfinite, values)):
            raise ValueError("a number is not finite")
    except ValueError as problem:
        raise ReferenceSetError(f"{file}, line {line}: {problem}") from None
    return values


def _skills(folder: Path, trial: Path, task: str, warnings: list[str]) -> dict[str, str]:
    """Skill by trial; what cannot be read is left out with a warning."""
    name = f"meta_file_{task}.txt"
    places = [folder / name, *(parent / name for parent in trial.parents[:3])]
    file = next((place for place in places if place.is_file()), None)
    if file is None:
        warnings.append(f"{name}: not found beside the trials; skills are unknown")
        return {}
    skills: dict[str, str] = {}
    try:
        lines = _lines(file)
    except ReferenceSetError as problem:
        warnings.append(f"{problem}; skills are unknown")
        return {}
    for number, line in enumerate(lines, start=1):
        trial_name, skill, *scores = [*line.split(), "", ""]
        if skill in SKILLS and any(scores):
            skills[trial_name] = SKILLS[skill]
        elif trial_name:
            warnings.append(
                f"{file}, line {number}: not a trial with a skill ({', '.join(SKILLS)}) and scores"
            )
    return skills


def _lines(file: Path) -> list[str]:
    try:
        return file.read_text(encoding="utf-8-sig").splitlines()
    except OSError as problem:
        raise ReferenceSetError(f"{file}: {problem.strerror}") from problem
    except UnicodeDecodeError as problem:
        raise ReferenceSetError(f"{file}: not a text file") from problem
