"""Provenance of a recording: the cell's files, their hashes, and software versions.

The manifest holds a copy of the YAML files, so a recording stays readable when the cell changes.
``surg_core`` checks the files; this module does not.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.metadata
import os
import platform
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml  # type: ignore[import]

import surg_recording
from surg_recording.calibration import endoscope_record

_PACKAGES = ("numpy", "scipy", "mujoco", "av", "opencv-python", "surg_core", "surg_recording")


def describe_cell(cell: Path, mounted: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Everything that a cell (its folder or its ``cell.yaml``) consists of.

    Args:
        cell: The folder or the file.
        mounted: Instrument and calibration by arm as on ``tool/mounted``, where they are known:
            two files relative to the cell's folder. Others have what the cell states.

    Returns:
        ``name``, ``folder``, ``files`` {path: SHA-256}, ``hash`` (SHA-256 over those), ``arms``
        {name: {robot, instrument, tool, trocar, mounted, limits, …}} with the contents of the YAML
        files and the limits as tightened by the cell, ``calibration`` {path: text} (the files as
        they are), ``endoscope`` (joints to camera, where an arm holds one). ``problems`` lists
        files that could not be read.
    """
    files = _CellFiles(cell if cell.is_file() else cell / "cell.yaml")
    content = files.load(files.cell_file)
    stated = content.get("arms")
    arms = {
        str(name): _describe_arm(
            str(name), arm if isinstance(arm, dict) else {}, files, (mounted or {}).get(name, "")
        )
        for name, arm in (stated if isinstance(stated, dict) else {}).items()
    }
    known = endoscope_record.calibration_files(files.cell_file.parent, arms)
    endoscope, problems = None, files.problems
    if not problems:
        endoscope, problems = endoscope_record.describe_endoscope(files.cell_file)
    texts = {files.relative(path.resolve()): files.add(path.resolve()) for path in known}
    total = "".join(f"{path}:{digest}\n" for path, digest in sorted(files.hashes.items()))
    return {
        "name": content.get("name", files.cell_file.parent.name),
        "folder": str(files.cell_file.parent),
        "network": content.get("network"),
        "files": files.hashes,
        "hash": hashlib.sha256(total.encode()).hexdigest(),
        "arms": arms,
        "calibration": {
            path: text.decode("utf-8", "replace") for path, text in texts.items() if text
        },
        "endoscope": endoscope,
        "problems": problems,
    }


class _CellFiles:
    """Reads the files of a cell; keeps their hashes by relative path, and read errors."""

    def __init__(self, cell_file: Path) -> None:
        self.cell_file = cell_file
        self.hashes: dict[str, str] = {}
        self.problems: list[str] = []

    def load(self, path: Path) -> dict[str, Any]:
        """Content of a YAML file; empty if it cannot be read."""
        data = self.add(path)
        if data is None:
            return {}
        try:
            content = yaml.safe_load(data)
        except yaml.YAMLError as problem:
            self.problems.append(f"{path}: {problem}")
            return {}
        if isinstance(content, dict):
            return content
        self.problems.append(f"{path}: no mapping")
        return {}

    def add(self, path: Path) -> bytes | None:
        """Note the hash of a file and return its content; None if it cannot be read."""
        try:
            data = path.read_bytes()
        except OSError as problem:
            self.problems.append(f"{path}: {problem}")
            return None
        self.hashes[self.relative(path)] = hashlib.sha256(data).hexdigest()
        return data

    def relative(self, path: Path) -> str:
        """A path as the manifest names it: relative to the cell."""
        return os.path.relpath(path, self.cell_file.parent.resolve())


def _describe_arm(
    name: str, arm: dict[str, Any], files: _CellFiles, mounted: str
) -> dict[str, Any]:
    entry: dict[str, Any] = dict(arm)
    folder = files.cell_file.parent
    calibrations = {key: f"calibration/{key}_{name}.yaml" for key in ("tool", "trocar")}
    if len(words := mounted.split()) == 2:
        entry["instrument"], calibrations["tool"] = words
    entry["mounted"] = f"{entry.get('instrument', '')} {calibrations['tool']}"
    for key in ("robot", "instrument"):
        path = (folder / str(entry.get(key, ""))).resolve()
        part = files.load(path)
        if "urdf" in part:
            files.add((path.parent / str(part["urdf"])).resolve())
        entry[f"{key}_file"] = files.relative(path)
        entry[key] = part
    for key, file in calibrations.items():
        entry[key] = files.load((folder / file).resolve())
    for key in ("camera", "base"):
        if (path := (folder / f"calibration/{key}_{name}.yaml").resolve()).is_file():
            entry[f"{key}_calibration"] = files.load(path)
    entry["limits"] = {**(entry["robot"].get("limits") or {}), **(entry.get("limits") or {})}
    listed = "".join(f"{key}:{value!r}\n" for key, value in sorted(entry["limits"].items()))
    entry["limits_hash"] = hashlib.sha256(listed.encode()).hexdigest()
    return entry


def versions() -> dict[str, str | None]:
    """Versions of this software and of what it computes with."""
    known: dict[str, str | None] = {
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "software": software_version(),
    }
    for name in _PACKAGES:
        try:
            known[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            module = sys.modules.get(name.replace("opencv-python", "cv2"))
            known[name] = getattr(module, "__version__", None)
    known["surg_recording"] = surg_recording.__version__
    if known["av"] is None:
        known["av"] = getattr(importlib.import_module("av"), "__version__", None)
    return known


def host() -> dict[str, Any]:
    """The recording machine, and the command line of this program."""
    return {"name": platform.node(), "cpus": os.cpu_count(), "command": list(sys.argv)}


def software_version() -> str | None:
    """``git describe --always --dirty`` of the source tree, or None outside one.

    Of a tree with uncommitted changes also eight digits of their SHA-256: one is not another.
    """
    version = _git("describe", "--always", "--dirty", "--tags").decode().strip()
    if version.endswith("-dirty"):
        version += f"-{hashlib.sha256(_git('diff', 'HEAD')).hexdigest()[:8]}"
    return version or None


def _git(*words: str) -> bytes:
    """What git says of the source tree; nothing outside one."""
    argv = ["git", "-C", str(Path(__file__).resolve().parent), *words]
    try:
        return subprocess.run(argv, capture_output=True, timeout=5.0, check=True).stdout
    except (OSError, subprocess.SubprocessError):
        return b""
