"""A RecordStatus of what is recorded; the manifest's entry of a SimStatus."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from surg_core.status_check import value_name
from surg_msgs.msg import RecordStatus, RecordStream, SimStatus, TaskStatus
from surg_recording.episode.episode_recorder import Recording


def describe_recording(
    message: RecordStatus, recording: Recording, waiting_for: Sequence[str]
) -> None:
    """Fill in what a recording holds; ``waiting_for``: topics that have sent nothing yet."""
    status = recording.status()

    def stream(name: str, received: int, kind: int) -> RecordStream:
        return RecordStream(
            name=name,
            kind=kind,
            received=received,
            dropped=status["drops"].get(name, 0),
            future=status["future_stamps"].get(name, 0),
        )

    message.folder = status["folder"]
    message.stage = status["stage"] or ""
    message.segments = status["segments"]
    message.streams = [
        *(stream(name, n, RecordStream.KIND_TABLE) for name, n in status["rows"].items()),
        *(stream(name, n, RecordStream.KIND_CAMERA) for name, n in status["frames"].items()),
    ]
    message.backlog_rows = status["backlog"]["rows"]
    message.backlog_frames = status["backlog"]["frames"]
    message.waiting_for = list(waiting_for)
    message.silent_cameras = status["silent_cameras"]
    message.warnings = status["warnings"]


def simulation_outcome(message: SimStatus) -> dict[str, Any]:
    """What the manifest keeps of the simulator under ``sim``."""
    return {
        "tick": message.tick,
        "sim_time_s": message.sim_time,
        "mode": value_name(message, "mode").lower(),
        "deterministic": message.deterministic,
        "state_hash": message.state_hash or None,
        "done": message.state == SimStatus.STATE_DONE,
        "aborted": message.detail if message.state == SimStatus.STATE_ABORTED else None,
        "overruns": message.overruns,
        "faults": list(message.faults),
        "task": task_outcome(message.task),
    }


def task_outcome(task: TaskStatus) -> dict[str, Any] | None:
    """What the manifest keeps of the task; None: there is none."""
    if task.state == TaskStatus.STATE_NONE:
        return None
    return {
        "name": task.name,
        "setting": task.setting,
        "phase": task.phase,
        "done": task.state in (TaskStatus.STATE_SUCCESS, TaskStatus.STATE_FAILURE),
        "success": task.state == TaskStatus.STATE_SUCCESS,
        "reason": task.detail,
    }
