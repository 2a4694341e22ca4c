"""The features of the task: reward and success, its ground truth, and what was to be done."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from surg_core.contract import TASK_STATE_KEY
from surg_recording.datasets import schema
from surg_recording.datasets.frames.frame_columns import HOLD, NEXT, Columns
from surg_recording.datasets.frames.resample import Grid, previous
from surg_recording.datasets.inspection import Candidate
from surg_recording.episode import table_columns
from surg_recording.episode.checked.checked_episode import CheckedEpisode
from surg_recording.episode.table import Table
from surg_recording.episode.verdicts import PERSON, Verdict


def task(made: Columns, episode: CheckedEpisode, candidate: Candidate) -> None:
    """All of them."""
    layout = candidate.layout
    if episode.task is not None:
        at_the_end = episode.segment is None or episode.segment.until is None
        _rewards(made, episode.task, candidate.verdict, at_the_end)
        if layout.task_numbers:
            _task_state(made, episode.task, layout.task_numbers)
    made.text(schema.INSTRUCTION, candidate.instruction, "what the operator was to do")
    stages = _stage_texts(candidate, made.grid)
    made.text(schema.STAGE, stages, "the same of the current stage", HOLD)
    tools = "; ".join(f"{a}: {i}" for a, i in zip(layout.arms, layout.instruments, strict=True))
    made.text(schema.TOOL, tools, "instrument of each arm")


def _rewards(made: Columns, task: Table, verdict: Verdict, at_the_end: bool) -> None:
    """Reward and success of the frame that an action leads to; the last frame has the verdict.

    A person's verdict counts first: what somebody called a failure has no frame of success.
    """
    row = previous(task["stamp_ns"], made.grid.next_ns, "task_state.csv")
    row[-1] = len(task) - 1
    last = np.zeros(made.grid.frames, dtype=bool)
    last[-1] = True
    made.number("next.reward", task["reward"][row], "float32", ("1",), NEXT, "reward of the task")
    made.number("next.done", last, "bool", ("1",), "", "the recording's last frame")
    success = task["success"][row] == 1
    if verdict.by == PERSON:
        success[:] = success & bool(verdict.success)
        success[-1] = bool(verdict.success) and at_the_end
    made.number("next.success", success, "bool", ("1",), NEXT, "the task was solved by then")


def _task_state(made: Columns, task: Table, numbers: tuple[str, ...]) -> None:
    """The task's own ground truth: the columns ``numbers`` of its state."""
    row = previous(task["stamp_ns"], made.grid.times_ns, "task_state.csv")
    names = tuple(name.removeprefix(table_columns.TASK_PREFIX) for name in numbers)
    made.vector(
        TASK_STATE_KEY,
        np.column_stack([task[name] for name in numbers])[row],
        names,
        ("SI",) * len(names),
        "as the task's page says (world)",
        HOLD,
        "ground truth of the task: no robot can measure it",
        privileged=True,
    )
    text = "stamp of the task's state"
    made.timing("task_state", task["stamp_ns"], row, made.grid.times_ns, text)


def _stage_texts(candidate: Candidate, grid: Grid) -> npt.NDArray[Any]:
    """What was to be done in each frame, (frames,); outside of all stages the instruction."""
    words = np.full(grid.frames, candidate.instruction, dtype=object)
    for stage in candidate.stages:
        inside = grid.times_ns >= stage.begin_ns
        if stage.end_ns is not None:
            inside &= grid.times_ns < stage.end_ns
        words[inside] = stage.text
    return words
