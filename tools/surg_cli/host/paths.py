"""Where things lie in a checkout."""

from __future__ import annotations

import datetime
import hashlib
import os
import tempfile
from pathlib import Path

from surg_cli.host.terminal import CliError


def state_folder(in_tree: Path) -> Path:
    """The tree's own folder; in a tree of another user, or read-only, one in the user's cache."""
    nearest = in_tree if in_tree.exists() else in_tree.parent
    if os.access(nearest, os.W_OK):
        return in_tree
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return cache / "surg" / hashlib.sha256(str(in_tree).encode()).hexdigest()[:16]


ROOT = Path(__file__).resolve().parents[3]
VENV = ROOT / ".venv"
VENV_PYTHON = VENV / "bin" / "python"
SYSTEM_PYTHON = Path("/usr/bin/python3")
BUILD = ROOT / "build"
DEVEL = ROOT / "devel"
TREE_STATE = ROOT / ".surg"
"""Stamps of the set-up and the build; written by the owner of the checkout only."""
STATE = state_folder(TREE_STATE)
"""Logs and the list of running systems of this user."""
SYSTEMS = STATE / "run"
RUNS = ROOT / "runs"
CELLS = ROOT / "cells"
APT_LIST = ROOT / "tools" / "apt-packages.txt"
LOCK_FILE = ROOT / "requirements.lock"
DDS_LOCK = ROOT / "src" / "surg_ros2" / "dds.lock"
"""What `--ros2` needs."""


def write_text(path: Path, text: str) -> None:
    """Replace a file in one step, so that a reader sees the old or the new text whole."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    with os.fdopen(handle, "w", encoding="utf-8") as stream:
        stream.write(text)
    umask = os.umask(0)
    os.umask(umask)
    os.chmod(name, 0o666 & ~umask)  # mkstemp's 0600 would lock other users of the tree out
    os.replace(name, path)


def existing(path: Path) -> Path:
    """The path itself, or its nearest parent that exists."""
    return next(each for each in (path, *path.parents) if each.exists())


def _check_writable(out: Path, what: str) -> None:
    parent = existing(out)
    if not parent.is_dir():
        raise CliError(f"{what}: {parent} is a file, not a folder; name another by --out", 2)
    if not os.access(parent, os.W_OK | os.X_OK):
        raise CliError(f"{what}: {parent} cannot be written; name another folder by --out", 2)


def file_digest(path: Path) -> str:
    """SHA-256 of a file's bytes, in hex."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def run_folder(wanted: Path | None) -> Path:
    """The folder of a run: the wanted one, or one named by the UTC time. Nothing is made.

    Raises:
        CliError: The folder is not empty or cannot be written, or its disk is nearly full.
    """
    if wanted is not None:
        out = wanted.absolute()
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise CliError(f"--out {wanted}: not an empty folder; name another or remove it", 2)
        _check_writable(out, f"--out {wanted}")
        return out
    _check_writable(RUNS, str(RUNS))
    now = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H-%M-%SZ")
    out, count = RUNS / now, 1
    while out.exists():
        count += 1
        out = RUNS / f"{now}_{count}"
    return out
