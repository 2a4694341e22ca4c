"""Tasks, found by name, by the path of a file, or by an entry point of an installed package.

An entry point in the group ``surg_sim.tasks`` names a class: ``my_task = my_package.file:MyTask``.
"""

from __future__ import annotations

from surg_core.plugins import PluginError, PluginKind
from surg_sim.tasks.task import State, Task, TaskError, Verdict

__all__ = ["State", "Task", "TaskError", "Verdict", "load", "names"]

_BUNDLED = (
    "bgr",
    "endoscope_guidance",
    "needle_driving",
    "pick_and_place",
    "thread_in_hole",
)
_KIND = PluginKind(
    noun="task",
    group="surg_sim.tasks",
    bundled={name: f"surg_sim.tasks.{name}.{name}_task" for name in _BUNDLED},
    accepts=lambda kind: issubclass(kind, Task),
    shape="one class derived from surg_sim.tasks.Task",
    required=("name", "title", "time_limit"),
)


def names() -> tuple[str, ...]:
    """Names that ``load`` knows: the bundled tasks, then those of installed packages."""
    return _KIND.names()


def load(name_or_path: str) -> Task:
    """A new task.

    Args:
        name_or_path: One of ``names``, or the path of a ``.py`` file that defines one task. A file
            is executed: load none that you would not run.

    Raises:
        TaskError: There is no such task, or the file holds none; lists what exists.
    """
    try:
        task: Task = _KIND.find(name_or_path)()
    except PluginError as error:
        raise TaskError(str(error)) from error
    return task
