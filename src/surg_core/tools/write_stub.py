"""Write the type stubs of the compiled core from the signatures that pybind11 puts into docstrings.

The build of the workspace runs it: ``write_stub.py FOLDER FILE`` with the folder of the module.
"""

from __future__ import annotations

import importlib
import inspect
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

HEAD = """# Written by the build.

import enum
import os
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

"""

TYPES = {
    "CellArm.home": "tuple[float, ...]",
    "CameraConfig.frames": "tuple[str, ...]",
    "CellConfig.arms": "tuple[CellArm, ...]",
    "RobotConfig.joint_names": "tuple[str, ...]",
    "shaft_angles": "tuple[float, float]",
    "Limits.as_dict": "dict[str, float]",
    "Tuning.as_dict": "dict[str, float]",
}
"""Results that pybind11 knows as a bare ``tuple`` or ``dict``."""


def stub(module: ModuleType) -> str:
    """The text of the module's ``.pyi`` file."""
    enumerations, classes, functions = [], [], []
    for name, value in sorted(vars(module).items()):
        if name.startswith("_") or inspect.ismodule(value):
            continue
        if not inspect.isclass(value):
            functions += function(name, value, name)
        elif hasattr(value, "__members__"):
            enumerations += enumeration(name, value)
        else:
            classes += list(members(name, value))
    text = "\n".join([*enumerations, *classes, *functions])
    return HEAD + text.replace(f"{module.__name__}.", "") + "\n"


def enumeration(name: str, kind: Any) -> list[str]:
    """Lines of an enumeration."""
    values = [f"    {member} = {int(value)}" for member, value in kind.__members__.items()]
    return [f"class {name}(enum.Enum):", *values, "    def __int__(self) -> int: ...", ""]


def members(name: str, kind: type) -> Iterator[str]:
    """Lines of a class: constructor, methods, properties."""
    if issubclass(kind, Exception):
        yield f"class {name}({kind.__base__.__name__}): ...\n"
        return
    lines: list[str] = []
    for member, value in vars(kind).items():
        where = f"{name}.{member}"
        if isinstance(value, property):
            _, result = signature(value.fget.__doc__ or "", where)
            lines += ["@property", f"def {member}(self) -> {result}: ..."]
        elif isinstance(value, staticmethod):
            lines += ["@staticmethod", *function(member, value.__func__, where)]
        elif member == "__init__" and "__init__(self" not in (value.__doc__ or ""):
            continue  # made by the core alone
        elif not inspect.isroutine(value):
            continue
        elif member in ("__init__", "__len__") or not member.startswith("_"):
            lines += function(member, value, where)
    yield f"class {name}:" if lines else f"class {name}: ..."
    yield from (f"    {line}" for line in lines)
    yield ""


def function(name: str, value: Any, where: str) -> list[str]:
    """The line that declares a function or method."""
    parameters, result = signature(inspect.getdoc(value) or "", where)
    return [f"def {name}({', '.join(parameters)}) -> {result}: ..."]


def signature(doc: str, where: str) -> tuple[list[str], str]:
    """Parameters and result in the first line of a docstring of pybind11."""
    line = doc.split("\n")[0]
    inside, result = line[line.index("(") + 1 :].rsplit(") -> ", 1)
    parameters = []
    for part in split(inside):
        name, colon, rest = part.partition(":")
        kind, equals, _ = rest.partition(" = ")
        if name.strip() in ("self", "arg0") or not colon:
            parameters.append("self" if colon else name.strip())
            continue
        parameters.append(f"{name.strip()}: {argument(kind)}" + (" = ..." if equals else ""))
    wanted = TYPES.get(where, outcome(result))
    return parameters, wanted


def split(text: str) -> list[str]:
    """Parts between commas that stand in no bracket."""
    parts, depth, word = [], 0, ""
    for letter in text + ",":
        depth += letter in "([{<"
        depth -= letter in ")]}>"
        if letter == "," and depth == 0:
            parts.append(word.strip())
            word = ""
        else:
            word += letter
    return [part for part in parts if part]


def plain(kind: str) -> str:
    """A type of pybind11 in today's syntax, arrays apart."""
    kind = re.sub(r"\[\d+\]", "", kind.strip())  # std::array's size
    kind = kind.replace("Tuple[", "tuple[").replace("buffer", "bytes")
    optional = re.fullmatch(r"Optional\[(.*)\]", kind)
    if optional:
        return f"{plain(optional[1])} | None"
    union = r"Union\[((?:[^\[\]]|\[[^\[\]]*\])*)\]"  # its members hold brackets of one level
    return re.sub(union, lambda m: " | ".join(map(plain, split(m[1]))), kind)


def argument(kind: str) -> str:
    """Type of a parameter: as wide as the conversion."""
    kind = plain(kind).replace("List[", "Sequence[").replace("Dict[", "Mapping[")
    kind = re.sub(r"numpy\.ndarray\[numpy\.float64\]", "npt.ArrayLike", kind)
    kind = re.sub(r"os\.PathLike(?!\[)", "str | os.PathLike[str]", kind)
    return re.sub(r"\bdict\b", "Mapping[str, object]", kind)


def outcome(kind: str) -> str:
    """Type of a result: as narrow as the conversion."""
    kind = plain(kind).replace("List[", "list[").replace("Dict[", "dict[")
    kind = kind.replace("numpy.ndarray[bool]", "npt.NDArray[np.bool_]")
    return re.sub(r"numpy\.ndarray\[numpy\.(\w+)\]", r"npt.NDArray[np.\1]", kind)


if __name__ == "__main__":
    folder, file = sys.argv[1:]
    sys.path.insert(0, folder)
    Path(file).write_text(stub(importlib.import_module("_core")), encoding="utf-8")
