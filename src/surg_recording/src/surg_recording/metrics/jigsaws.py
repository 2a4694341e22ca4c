"""JIGSAWS: kinematics of exercises on a da Vinci, as the data set's files hold them.

The data set (Y. Gao et al., "The JHU-ISI Gesture and Skill Assessment Working Set", M2CAI 2014)
needs registration and is never part of this project. A task's folder holds::

    Knot_Tying/kinematics/AllGestures/Knot_Tying_B001.txt    one trial: subject B, trial 1
    Knot_Tying/meta_file_Knot_Tying.txt                      skill and scores, one line per trial

A trial is text without a header: one line per sample at 30 Hz, 76 numbers. Four manipulators have
19 each: position [m] (3), rotation matrix row by row (9), linear velocity [m/s] (3), angular
velocity [rad/s] (3), gripper angle [rad] (1).
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from surg_recording.recording_errors import ReferenceSetError

Array = npt.NDArray[np.float64]

FS = 30.0
"""[Hz]"""
COLUMNS = 76
MANIPULATORS = ("master_left", "master_right", "slave_left", "slave_right")
"""In the order of their columns. The slaves are the instruments: PSM1 is ``slave_left``."""
PSM1 = "slave_left"
SKILLS = {"N": "novice", "I": "intermediate", "E": "expert"}
"""By hours of practice, as the subjects stated them."""
SHORTEST = 60
"""Trials with fewer samples (2 s) are left out: at 5 Hz nothing of them is left."""

_PLACE = "kinematics/AllGestures"
_NAME = re.compile(r"^(?P<task>.+)_(?P<subject>[A-Za-z])(?P<number>\d{3})$")


@dataclasses.dataclass(frozen=True)
class Manipulator:
    """The N samples of one manipulator, in the frame that the file uses for it."""

    p: Array
    """(N, 3) position [m]."""
    R: Array
    """(N, 3, 3) orientation."""
    v: Array
    """(N, 3) linear velocity [m/s]."""
    w: Array
    """(N, 3) angular velocity [rad/s]."""
    gripper: Array
    """(N,) angle [rad]."""


@dataclasses.dataclass(frozen=True)
class Meta:
    """What the meta file says about a trial."""

    skill: str
    """Of ``SKILLS``: N, I, E."""
    score: int
    """Global rating score, the sum of its elements."""
    elements: tuple[int, ...]
    """The elements of the score, as many as the file has."""


@dataclasses.dataclass(frozen=True)
class Trial:
    """One trial."""

    name: str
    """As its file: ``Knot_Tying_B001``."""
    task: str
    subject: str
    number: int
    samples: Array
    """(N, 76), read-only."""
    meta: Meta | None
    """None where the meta file does not name the trial."""

    def manipulator(self, name: str = PSM1) -> Manipulator:
        """One of the ``MANIPULATORS``.

        Raises:
            ValueError: There is none of that name.
        """
        if name not in MANIPULATORS:
            raise ValueError(f"no manipulator {name!r}; there are {', '.join(MANIPULATORS)}")
        first = 19 * MANIPULATORS.index(name)
        part = self.samples[:, first : first + 19]
        return Manipulator(
            p=part[:, 0:3],
            R=part[:, 3:12].reshape(-1, 3, 3),
            v=part[:, 12:15],
            w=part[:, 15:18],
            gripper=part[:, 18],
        )


@dataclasses.dataclass(frozen=True)
class DataSet:
    """The trials of one task that could be read, and why others could not."""

    task: str
    trials: tuple[Trial, ...]
    warnings: tuple[str, ...]
    """What was left out and why, one sentence each."""


def read(folder: Path | str) -> DataSet:
    """Read all trials of one task.

    Args:
        folder: The task's folder, its ``kinematics/AllGestures``, or the data set's with only one
            task in it.

    Returns:
        The trials by name. A file that is empty, short or broken is left out and said to be.

    Raises:
        ReferenceSetError: No such folder, no trial in it, several tasks, or none can be read.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ReferenceSetError(f"{folder}: no such folder")
    files = sorted(folder.rglob(f"{_PLACE}/*.txt")) or sorted(folder.glob("*.txt"))
    named = [(file, match) for file in files if (match := _NAME.match(file.stem))]
    if not named:
        raise ReferenceSetError(
            f"{folder}: no JIGSAWS trial; a task's folder with {_PLACE}/<Task>_<Subject><nnn>.txt"
            " is needed"
        )
    tasks = sorted({match["task"] for _, match in named})
    if len(tasks) > 1:
        raise ReferenceSetError(
            f"{folder}: holds several tasks ({', '.join(tasks)}), which do not belong in one box;"
            f" name the folder of one, such as {folder / tasks[0]}"
        )
    warnings: list[str] = []
    metas = _metas(folder, named[0][0], tasks[0], warnings)
    trials = []
    for file, match in named:
        try:
            samples = read_samples(file)
        except ReferenceSetError as problem:
            warnings.append(str(problem))
            continue
        name = file.stem
        number = int(match["number"])
        trials.append(
            Trial(name, match["task"], match["subject"], number, samples, metas.get(name))
        )
    if not trials:
        raise ReferenceSetError(f"{folder}: no trial can be read; the first: {warnings[0]}")
    return DataSet(tasks[0], tuple(trials), tuple(warnings))


def read_samples(file: Path) -> Array:
    """The samples of one trial.

    Returns:
        (N, 76), read-only.

    Raises:
        ReferenceSetError: Empty, short, or not as the format says, with file and line.
    """
    rows = []
    for number, line in enumerate(_lines(file), start=1):
        fields = line.split()
        if not fields:
            continue
        if len(fields) != COLUMNS:
            raise ReferenceSetError(
                f"{file}, line {number}: {len(fields)} numbers, {COLUMNS} are needed"
            )
        rows.append(_numbers(file, number, fields))
    if not rows:
        raise ReferenceSetError(f"{file}: empty")
    if len(rows) < SHORTEST:
        raise ReferenceSetError(
            f"{file}: {len(rows)} samples, at least {SHORTEST} ({SHORTEST / FS:g} s) are needed"
        )
    samples = np.array(rows)
    samples.setflags(write=False)
    return samples


def _numbers(file: Path, number: int, fields: Sequence[str]) -> list[float]:
    try:
        values = [float(field) for field in fields]
    except ValueError as problem:
        raise ReferenceSetError(f"{file}, line {number}: {problem}") from None
    if not all(map(math.isfinite, values)):
        raise ReferenceSetError(f"{file}, line {number}: a number is not finite")
    return values


def _metas(folder: Path, trial: Path, task: str, warnings: list[str]) -> dict[str, Meta]:
    """Skill and scores by trial; what cannot be read is noted and left out."""
    name = f"meta_file_{task}.txt"
    places = [folder / name, *(parent / name for parent in trial.parents[:3])]
    file = next((place for place in places if place.is_file()), None)
    if file is None:
        warnings.append(f"{name}: not found beside the trials; skills are unknown")
        return {}
    found: dict[str, Meta] = {}
    try:
        lines = _lines(file)
    except ReferenceSetError as problem:
        warnings.append(f"{problem}; skills are unknown")
        return {}
    for number, line in enumerate(lines, start=1):
        fields = line.split()
        if not fields:
            continue
        try:
            name, skill, *rest = fields
            score, *elements = (int(field) for field in rest)
        except ValueError:
            skill = ""
        if skill not in SKILLS:
            warnings.append(
                f"{file}, line {number}: not a trial with a skill ({', '.join(SKILLS)}) and scores"
            )
            continue
        found[name] = Meta(skill, score, tuple(elements))
    return found


def _lines(file: Path) -> list[str]:
    try:
        return file.read_text(encoding="utf-8").splitlines()
    except OSError as problem:
        raise ReferenceSetError(f"{file}: {problem.strerror}") from problem
    except UnicodeDecodeError as problem:
        raise ReferenceSetError(f"{file}: not a text file") from problem
