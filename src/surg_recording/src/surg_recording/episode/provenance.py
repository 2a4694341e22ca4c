"""What a recording was made with: the cell's files, their hashes, and software versions.

The YAML files are copied into the manifest as they are, so that a recording can be understood when
the cell has changed since. Checking them is the schema's business in ``surg_core``.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.metadata
import os
import platform
import subprocess
import sys
from pathlib import Path
from typing import Any

import yaml  # type: ignore[import]

import surg_recording

_PACKAGES = ("numpy", "scipy", "mujoco", "av", "opencv-python", "surg_core", "surg_recording")


def describe_cell(cell: Path) -> dict[str, Any]:
    """Everything a cell consists of.

    Args:
        cell: the cell's folder or its ``cell.yaml``.

    Returns:
        ``name``, ``folder``, ``files`` {path: SHA-256}, ``hash`` (SHA-256 over those), ``arms``
        {name: {robot, instrument, tool, trocar, limits, …}} with the contents of the YAML files and
        the limits as tightened by the cell. What cannot be read is named under ``problems``.
    """
    file = cell if cell.is_file() else cell / "cell.yaml"
    files: dict[str, str] = {}
    problems: list[str] = []

    def load(path: Path) -> dict[str, Any]:
        try:
            data = path.read_bytes()
            files[_shown(path, file.parent)] = hashlib.sha256(data).hexdigest()
            content = yaml.safe_load(data)
            if isinstance(content, dict):
                return content
            problems.append(f"{path}: no mapping")
        except (OSError, yaml.YAMLError) as problem:
            problems.append(f"{path}: {problem}")
        return {}

    def remember(path: Path) -> None:
        try:
            files[_shown(path, file.parent)] = hashlib.sha256(path.read_bytes()).hexdigest()
        except OSError as problem:
            problems.append(f"{path}: {problem}")

    content = load(file)
    arms: dict[str, Any] = {}
    stated = content.get("arms")
    for name, arm in (stated if isinstance(stated, dict) else {}).items():
        entry: dict[str, Any] = dict(arm) if isinstance(arm, dict) else {}
        for key in ("robot", "instrument"):
            path = (file.parent / str(entry.get(key, ""))).resolve()
            part = load(path)
            if "urdf" in part:
                remember((path.parent / str(part["urdf"])).resolve())
            entry[f"{key}_file"] = _shown(path, file.parent)
            entry[key] = part
        for key in ("tool", "trocar"):
            entry[key] = load(file.parent / "calibration" / f"{key}_{name}.yaml")
        entry["limits"] = {**(entry["robot"].get("limits") or {}), **(entry.get("limits") or {})}
        listed = "".join(f"{key}:{value!r}\n" for key, value in sorted(entry["limits"].items()))
        entry["limits_hash"] = hashlib.sha256(listed.encode()).hexdigest()
        arms[str(name)] = entry
    total = hashlib.sha256("".join(f"{k}:{v}\n" for k, v in sorted(files.items())).encode())
    return {
        "name": content.get("name", file.parent.name),
        "folder": str(file.parent),
        "network": content.get("network"),
        "files": files,
        "hash": total.hexdigest(),
        "arms": arms,
        "problems": problems,
    }


def versions(source: Path | None = None) -> dict[str, str | None]:
    """Versions of what computes, and of this software.

    Args:
        source: a folder of the source tree for ``git describe``; default: where this file lies.
    """
    found: dict[str, str | None] = {
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "software": software_version(source),
    }
    for name in _PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            module = sys.modules.get(name.replace("opencv-python", "cv2"))
            found[name] = getattr(module, "__version__", None)
    found["surg_recording"] = surg_recording.__version__
    if found["av"] is None:
        found["av"] = getattr(importlib.import_module("av"), "__version__", None)
    return found


def host() -> dict[str, Any]:
    """The machine that records, and how this program was started."""
    return {"name": platform.node(), "cpus": os.cpu_count(), "command": list(sys.argv)}


def software_version(source: Path | None = None) -> str | None:
    """``git describe --always --dirty`` of the source tree, or None outside one."""
    folder = source or Path(__file__).resolve().parent
    try:
        answer = subprocess.run(
            ["git", "-C", str(folder), "describe", "--always", "--dirty", "--tags"],
            capture_output=True,
            text=True,
            timeout=5.0,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return answer.stdout.strip() or None if answer.returncode == 0 else None


def _shown(path: Path, base: Path) -> str:
    """A path as the manifest names it: relative to the cell."""
    return os.path.relpath(path, base.resolve())
