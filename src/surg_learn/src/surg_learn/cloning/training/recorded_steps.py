"""All steps of a LeRobot dataset (v2.1) with small pictures and phases, for `train_cloned.py`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from surg_learn.cloning.arm_columns import (
    ACTION,
    SET,
    STATE,
    Array,
    arm_of,
    columns_of,
    state_columns,
)
from surg_learn.cloning.training.lerobot_dataset import (
    RATE,
    Progress,
    facts,
    last_commands,
    names_of,
    recordings,
    targets_of,
)

LEFT, RIGHT = (f"observation.images.endoscope.{side}" for side in ("left", "right"))
PHASE = "annotation.human.action.subtask_description"
"""Column of a frame's phase: a place in `meta/tasks.jsonl`. It is the recording's stage: the
task's own, or what a person marked with `./surg episode label`."""
WHOLE = "annotation.human.action.task_description"
"""The same of the whole task; it stands where no phase is."""
NO_PHASE = -1
SHUT = 0.1
"""Commanded jaws less open than this close on something [rad]."""
HOLDS = RATE
"""Steps after which closed jaws hold something: who sees that they do not opens them within 1 s."""


@dataclass
class Recorded:
    """All steps of all episodes, one after the other; N steps, E episodes.

    Attributes:
        state: (N, n) `observation.state`.
        action: (N, 5) absolute: tip [m], roll [rad], jaw [rad].
        phase: (N,) place in ``phases``; `NO_PHASE` where the recording states none.
        begins: (E + 1,) first step of each episode, then N.
        split: Of each episode.
        views: (N, SIDE, SIDE, 3), uint8, for each eye.
        names: Columns of state and action.
        phases: Sentences, in the order in which they first appear.
        about: Facts of the dataset.
    """

    state: Array
    action: Array
    phase: Array
    begins: Array
    split: list[str]
    views: dict[str, Array]
    names: dict[str, list[str]]
    phases: list[str]
    about: dict[str, Any]

    def episodes(self, split: str) -> list[slice]:
        """Steps of each episode of a split."""
        ends = zip(self.begins[:-1], self.begins[1:], self.split, strict=True)
        return [slice(int(begin), int(end)) for begin, end, of in ends if of == split]


@dataclass
class Steps:
    """M steps to learn from, or to judge by.

    Attributes:
        rows: (M,) in the arrays of `Recorded`.
        state: (M, 9) of `state_columns`.
        last: (M, 4) last commands.
        targets: (M, chunk, 5), tip and roll relative to the last command.
        phase: (M,)
    """

    rows: Array
    state: Array
    last: Array
    targets: Array
    phase: Array

    @classmethod
    def of(cls, found: Recorded, split: str, chunk: int) -> Steps:
        """Those of a split, but for those that lead to a miss."""
        columns = state_columns(found.names[STATE], arm_of(found.names[ACTION]))
        parts = []
        for episode in found.episodes(split):
            state, action = found.state[episode][:, columns], found.action[episode]
            last = last_commands(state, action, SET)
            targets = targets_of(action, last, chunk)
            good = ~missed(action[:, 4])
            rows = np.arange(episode.start, episode.stop)
            parts.append([a[good] for a in (rows, state, last, targets, found.phase[episode])])
        return cls(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def eyes_of(eyes: int) -> tuple[str, ...]:
    """Pictures of one eye or of both."""
    return (LEFT, RIGHT)[:eyes]


def read(
    folder: Path, pictures: Sequence[str], arm: str, progress: Progress = lambda part, note: None
) -> Recorded:
    """Read a dataset, with its videos.

    Args:
        folder: Of the dataset.
        pictures: Their keys.
        arm: Whose columns of state and action are read: other arms may be driven, too.
        progress: Is told how far it is.

    Raises:
        ValueError: The folder is no dataset, or lacks a feature, a picture or the arm.
    """
    info = facts(folder, (STATE, ACTION, *pictures))
    named = [PHASE, WHOLE] if {PHASE, WHOLE} <= set(info["features"]) else []
    found = list(recordings(folder, info, (STATE, ACTION, *named), pictures, progress))
    if not found:
        raise ValueError(f"{folder}: the dataset has no episode")
    whole = {key: np.concatenate([each[key] for _, each in found]) for key in found[0][1]}
    phase, phases = np.full(len(whole[STATE]), NO_PHASE), list[str]()
    if named:
        phase, phases = numbered(whole[PHASE].ravel(), whole[WHOLE].ravel(), sentences(folder))
    shape = info["features"][pictures[0]]["shape"]
    names = names_of(info, (STATE, ACTION))
    own = {
        key: [name for name in each if name.startswith(f"{arm}/")] for key, each in names.items()
    }
    if not own[ACTION]:
        raise ValueError(f"{folder}: no action of {arm}; it has {', '.join(names[ACTION])[:200]}")
    state, action = (whole[k][:, columns_of(k, names[k], own[k])] for k in (STATE, ACTION))
    return Recorded(
        state,
        action,
        phase,
        np.cumsum([0, *(len(each[STATE]) for _, each in found)]),
        [split for split, _ in found],
        {key: whole[key] for key in pictures},
        own,
        phases,
        {"fps": info["fps"], "robot": info["robot_type"], "picture": shape},
    )


def sentences(folder: Path) -> dict[int, str]:
    """Those of `meta/tasks.jsonl`, by place.

    Raises:
        ValueError: The file is not there or cannot be read.
    """
    file = folder / "meta" / "tasks.jsonl"
    try:
        rows = [json.loads(line) for line in file.read_text("utf-8").splitlines() if line]
        return {int(row["task_index"]): str(row["task"]) for row in rows}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{file}: no sentences of the phases ({error!r})") from None


def numbered(places: Array, whole: Array, said: dict[int, str]) -> tuple[Array, list[str]]:
    """Phases by the order of their first appearance, and their sentences.

    Args:
        places: (N,) in ``said``.
        whole: (N,) place of the whole task, which stands where no phase is.
        said: Sentences.
    """
    known = [int(p) for p, w in zip(places, whole, strict=True) if p != w]
    order = {place: n for n, place in enumerate(dict.fromkeys(known))}
    phase = [order[int(p)] if p != w else NO_PHASE for p, w in zip(places, whole, strict=True)]
    return np.array(phase), [said.get(place, str(place)) for place in order]


def missed(jaw: Array) -> Array:
    """Steps that lead to a grasp that holds nothing, (T,): from open jaws to the closing.

    Jaws that soon open again have held nothing. How to aim is not learned from these steps.

    Args:
        jaw: (T,) commanded jaw angles [rad].
    """
    shut = jaw < SHUT
    closes = np.flatnonzero(shut[1:] & ~shut[:-1]) + 1
    found = np.zeros(len(jaw), bool)
    for begin, end in zip(closes, [*closes[1:], len(jaw)], strict=True):
        if not shut[begin : min(begin + HOLDS, end)].all():
            before = np.flatnonzero(shut[:begin])
            found[(before[-1] + 1 if len(before) else 0) : begin + 1] = True
    return found
