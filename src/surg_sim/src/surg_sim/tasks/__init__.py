"""Tasks, found by name, by the path of a file, or by an entry point of an installed package.

An entry point in the group ``surg_sim.tasks`` names a class: ``my_task = my_package.file:MyTask``.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import sys
from importlib import metadata
from pathlib import Path
from types import ModuleType

from surg_sim.tasks.task import State, Task, TaskError, Verdict

__all__ = ["State", "Task", "TaskError", "Verdict", "load", "names"]

GROUP = "surg_sim.tasks"
"""Entry points of other packages."""

_BUNDLED = ("bgr", "endoscope_guidance", "pick_and_place")


def names() -> tuple[str, ...]:
    """Names that ``load`` knows: the bundled tasks, then those of installed packages."""
    found = {point.name for point in metadata.entry_points(group=GROUP)}
    return (*_BUNDLED, *sorted(found - set(_BUNDLED)))


def load(name_or_path: str) -> Task:
    """A new task.

    Args:
        name_or_path: Of ``names``, or the path of a ``.py`` file that defines one task. A file is
            executed: load none that you would not run.

    Raises:
        TaskError: There is no such task, or the file holds none; lists what exists.
    """
    if name_or_path.endswith(".py"):
        return _only_task(_module_of(Path(name_or_path)), name_or_path)()
    if name_or_path in _BUNDLED:
        module = importlib.import_module(f"surg_sim.tasks.{name_or_path}.{name_or_path}_task")
        return _only_task(module, name_or_path)()
    for point in metadata.entry_points(group=GROUP):
        if point.name == name_or_path:
            kind = point.load()
            if not (inspect.isclass(kind) and issubclass(kind, Task)):
                raise TaskError(f"entry point '{point.value}' of task '{point.name}' is no Task")
            return kind()
    raise TaskError(
        f"no task '{name_or_path}': there are {', '.join(names())}, or the path of a .py file"
    )


def _module_of(path: Path) -> ModuleType:
    if not path.is_file():
        raise TaskError(f"no task file {path}: known names are {', '.join(names())}")
    name = f"surg_sim_task_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None  # of a file that ends in .py
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise TaskError(f"{path}: {type(error).__name__}: {error}") from error
    return module


def _only_task(module: ModuleType, where: str) -> type[Task]:
    found = [
        kind
        for _, kind in inspect.getmembers(module, inspect.isclass)
        if issubclass(kind, Task) and kind.__module__ == module.__name__
    ]
    if len(found) != 1:
        raise TaskError(
            f"{where} defines {len(found)} tasks: one class derived from surg_sim.tasks.Task is "
            "needed"
        )
    missing = [key for key in ("name", "title", "time_limit") if not hasattr(found[0], key)]
    if inspect.isabstract(found[0]) or missing:
        missing += sorted(found[0].__abstractmethods__)
        raise TaskError(f"{where}: {found[0].__name__} lacks {', '.join(missing)}")
    return found[0]
