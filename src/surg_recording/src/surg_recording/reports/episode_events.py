"""The events of an episode's page: states, messages and a task's phases on the axis of stamps."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from surg_recording.episode import table_file
from surg_recording.episode.episode_reader import Episode
from surg_recording.episode.table import Table
from surg_recording.recording_errors import EpisodeError

MAX_EVENTS = 2000

Stamps = npt.NDArray[np.int64]


def collect(
    episode: Episode, origin: int, end: int, cycle: Table | None, missing: list[str]
) -> list[dict[str, Any]]:
    """States, messages and the phases of a task, in order of time."""
    events: list[dict[str, Any]] = []
    try:
        if "events" in episode.tables:
            table = table_file.read_table(episode.folder / "events.csv")
            columns = (table[name] for name in ("stamp_ns", "receive_ns", "topic", "text"))
            for stamp, receive, topic, content in zip(*columns, strict=True):
                t, exact = _when(int(stamp), int(receive), cycle, origin, end)
                kind, text = _event(str(topic), str(content))
                events.append({"t": t - origin, "kind": kind, "text": text, "exact": exact})
    except EpisodeError as problem:
        missing.append(str(problem))
    try:
        for stamp, name in phases(episode):
            text = f"phase: {name}"
            events.append({"t": stamp - origin, "kind": "phase", "text": text, "exact": True})
    except EpisodeError as problem:
        missing.append(str(problem))
    events.sort(key=lambda event: event["t"])
    if not events:
        missing.append("no events were recorded")
    if len(events) > MAX_EVENTS:
        missing.append(f"only {MAX_EVENTS} of {len(events)} events are shown, the first ones")
    return events[:MAX_EVENTS]


def _when(stamp: int, receive: int, cycle: Table | None, origin: int, end: int) -> tuple[int, bool]:
    """Time of an event on the axis of the stamps, and whether it is its own stamp.

    An event without a stamp, or with one of another clock, is shown at the cycles received with it.
    """
    if origin <= stamp <= end:
        return stamp, True
    if cycle is None:
        return min(max(receive, origin), end), False
    row = max(at_or_before(cycle["receive_ns"], receive), 0)
    return int(cycle["stamp_ns"][row]), False


def _event(topic: str, content: str) -> tuple[str, str]:
    """Kind and text of an event."""
    arm, _, name = topic.strip("/").rpartition("/")
    if name == "operating_state":
        try:
            state = json.loads(content)
            words = [state["state"], "homed" if state["is_homed"] else "not homed"]
            words += ["busy"] if state["is_busy"] else []
            return "state", f"{arm}: {', '.join(words)}"
        except (ValueError, KeyError, TypeError):
            return "state", f"{arm}: {content}"
    if topic == "/sim/status":
        return "state", "the simulation ended"
    kind = name if name in ("error", "warning") else "status"
    text = content.removeprefix(f"{arm}: ") or name
    return kind, f"{arm}: {text}" if arm else text


def phases(episode: Episode) -> list[tuple[int, str]]:
    """Stamp [ns] and name of each phase of the task as it begins; none without a task.

    Raises:
        EpisodeError: Its table cannot be read.
    """
    if "task_state" not in episode.tables:
        return []
    file = episode.folder / "task_state.csv"
    table = table_file.read_table(file, wanted=("stamp_ns", "phase"))
    names = table["phase"]
    changes = [i for i in range(len(table)) if i == 0 or names[i] != names[i - 1]]
    return [(int(table["stamp_ns"][i]), str(names[i])) for i in changes]


def at_or_before(stamps: Sequence[int] | Stamps, t: int) -> int:
    """Index of the last of increasing stamps that is not later than t [ns]; −1 before the first."""
    return int(np.searchsorted(np.asarray(stamps), t, side="right")) - 1
