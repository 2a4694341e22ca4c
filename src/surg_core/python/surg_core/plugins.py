"""Plug-ins: classes found by name, by entry point of an installed package, or by path of a file.

Tasks, leaders and exporters are found this way. A package states once what its plug-ins are::

    TASKS = PluginKind("task", "surg_sim.tasks", {"bgr": "surg_sim.tasks.bgr.bgr_task"}, is_task,
                       "one class derived from surg_sim.tasks.Task")
    task = TASKS.find("bgr")()

Another package adds one with an entry point in the group: ``my_task = my_package.file:MyTask``.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import metadata
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import ModuleType
from typing import Any

_FROM_FILE = "surg_plugin_"  # begins the names of modules that were loaded by path


def source_file(plugin: object) -> str | None:
    """Path of the file that a plug-in was loaded from; None: it was found by name."""
    module = type(plugin).__module__
    return sys.modules[module].__file__ if module.startswith(_FROM_FILE) else None


class PluginError(ValueError):
    """A plug-in that cannot be found or used.

    Attributes:
        where: The name, path or entry point asked for.
        what: What is wrong with it.
        cure: What is allowed.
    """

    def __init__(self, where: str, what: str, cure: str) -> None:
        """Joins the parts to one sentence."""
        super().__init__(f"{where}: {what}; {cure}")
        self.where, self.what, self.cure = where, what, cure


class _Uncached(SourceFileLoader):
    """Reads the text each time: byte code kept by the second and the size may be of another one."""

    def path_stats(self, path: str) -> Any:
        """Refuse, so that no byte code is read or left beside a person's file."""
        raise OSError(path)


@dataclass(frozen=True)
class PluginKind:
    """One kind of plug-in.

    Attributes:
        noun: What one is called in messages.
        group: Entry-point group of other packages.
        bundled: Module of each bundled plug-in, by name.
        accepts: True for a class that is one.
        shape: What a file must define, for messages.
        required: Class attributes without a default.
    """

    noun: str
    group: str
    bundled: Mapping[str, str]
    accepts: Callable[[type], bool]
    shape: str
    required: tuple[str, ...] = ()

    def names(self) -> tuple[str, ...]:
        """Names that :meth:`find` knows: the bundled ones, then those of installed packages."""
        return (*self.bundled, *sorted(self._entry_points().keys() - set(self.bundled)))

    def find(self, name_or_path: str) -> type[Any]:
        """The class of a plug-in.

        Args:
            name_or_path: One of :meth:`names`, or the path of a ``.py`` file that defines one
                plug-in. A file is executed: pass none that you would not run.

        Raises:
            PluginError: There is no such plug-in, its module fails, or it is not a complete one.
        """
        if name_or_path.endswith(".py"):
            return self._only_class(self._load_file(Path(name_or_path)), name_or_path)
        if name_or_path in self.bundled:
            module = importlib.import_module(self.bundled[name_or_path])
            return self._only_class(module, name_or_path)
        point = self._entry_points().get(name_or_path)
        if point is None:
            raise PluginError(
                name_or_path,
                f"there is no such {self.noun}",
                f"there are {', '.join(self.names())}, or the path of a .py file",
            )
        try:
            loaded = point.load()
        except Exception as error:
            raise self._failed(f"entry point '{point.value}'", error) from error
        if not (inspect.isclass(loaded) and self.accepts(loaded)):
            raise PluginError(
                name_or_path,
                f"entry point '{point.value}' is no {self.noun}",
                f"it must name {self.shape}",
            )
        return self._complete(loaded, name_or_path)

    def _entry_points(self) -> dict[str, metadata.EntryPoint]:
        return {point.name: point for point in metadata.entry_points(group=self.group)}

    def _load_file(self, path: Path) -> ModuleType:
        if not path.is_file():
            raise PluginError(
                str(path), "there is no such file", f"known names are {', '.join(self.names())}"
            )
        name = f"{_FROM_FILE}{self.group.replace('.', '_')}_{path.stem}"
        loader = _Uncached(name, str(path))
        spec = importlib.util.spec_from_file_location(name, path, loader=loader)
        assert spec is not None and spec.loader is not None  # of a file that ends in .py
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module  # dataclasses look their module up
        try:
            spec.loader.exec_module(module)
        except Exception as error:
            raise self._failed(str(path), error) from error
        return module

    def _failed(self, where: str, error: Exception) -> PluginError:
        return PluginError(where, f"{type(error).__name__}: {error}", "it must be importable")

    def _only_class(self, module: ModuleType, where: str) -> type[Any]:
        found = [
            kind
            for _, kind in inspect.getmembers(module, inspect.isclass)
            if kind.__module__ == module.__name__ and self.accepts(kind)
        ]
        if len(found) != 1:
            raise PluginError(
                where, f"defines {len(found)} {self.noun}s", f"{self.shape} is needed"
            )
        return self._complete(found[0], where)

    def _complete(self, kind: type[Any], where: str) -> type[Any]:
        missing = [name for name in self.required if not hasattr(kind, name)]
        missing += sorted(getattr(kind, "__abstractmethods__", ()))
        if missing:
            raise PluginError(
                where, f"{kind.__name__} lacks {', '.join(missing)}", f"{self.shape} is needed"
            )
        return kind
