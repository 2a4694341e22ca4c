"""What the page shows of the phantom's task: its sentence, the phase in words, how it ended."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

from surg_console.session.system_state import Robot, SimTask


class TaskView:
    """The task of a system, with the time that people took for an episode.

    Args:
        language: JSON of the task's ``instruction``, and of ``stages``: phase -> sentence, in their
            order. Empty: the task is shown by the names of itself and its phases.

    Raises:
        ValueError: It is no JSON object of these.
    """

    def __init__(self, language: str = "") -> None:
        stated = json.loads(language or "{}")
        stages = stated.get("stages") or {} if isinstance(stated, Mapping) else None
        if not isinstance(stages, Mapping):
            raise ValueError("an object of instruction and stages is needed")
        self._sentence = str(stated.get("instruction") or "")
        self._stages = {str(phase): str(words) for phase, words in stages.items()}
        self._seed, self._began, self._took = -1, math.inf, math.nan

    def report(self, robot: Robot, now: float) -> dict[str, Any] | None:
        """For the page; None: there is no task. ``now``: on the steady clock [s]."""
        task = robot.task
        if task.state in ("", "NONE"):
            return None
        self._watch(task, robot.follower.state == "FOLLOWING" or robot.policy.active, now)
        phases = [*self._stages, ""]
        after = phases[phases.index(task.phase) + 1] if task.phase in self._stages else ""
        running = task.state == "RUNNING"
        return {
            "sentence": self._sentence or task.name,
            "now": self._stages.get(task.phase, task.phase) if running else "",
            "next": self._stages.get(after, "") if running else "",
            "ended": "" if running else self._end(task),
            "success": task.state == "SUCCESS",
        }

    def _watch(self, task: SimTask, moves: bool, now: float) -> None:
        """Time runs from the first motion of an episode to its end."""
        if task.seed != self._seed:
            self._seed, self._began, self._took = task.seed, math.inf, math.nan
        if task.state != "RUNNING":
            if math.isnan(self._took):
                self._took = now - self._began
        elif moves:
            self._began = min(self._began, now)

    def _end(self, task: SimTask) -> str:
        word = "Success" if task.state == "SUCCESS" else "Failure"
        after = f" after {self._took:.1f} s" if self._took >= 0.0 else ""
        return f"{word}{after}" + (f": {task.detail}" if task.detail else "")
