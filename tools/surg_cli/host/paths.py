"""Where things lie in a checkout."""

from __future__ import annotations

import datetime
import hashlib
import os
import tempfile
from pathlib import Path

from surg_cli.host.terminal import Problem

ROOT = Path(__file__).resolve().parents[3]
VENV = ROOT / ".venv"
VENV_PYTHON = VENV / "bin" / "python"
SYSTEM_PYTHON = Path("/usr/bin/python3")
BUILD = ROOT / "build"
DEVEL = ROOT / "devel"
STATE = ROOT / ".surg"
SYSTEMS = STATE / "run"
RUNS = ROOT / "runs"
CELLS = ROOT / "cells"
APT_LIST = ROOT / "tools" / "apt-packages.txt"
LOCK_FILE = ROOT / "requirements.lock"


def write_text(path: Path, text: str) -> None:
    """Replace a file in one step, so that a reader sees the old or the new text whole."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    with os.fdopen(handle, "w", encoding="utf-8") as stream:
        stream.write(text)
    os.replace(name, path)


def file_digest(path: Path) -> str:
    """SHA-256 of a file's bytes, in hex."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def run_folder(wanted: Path | None) -> Path:
    """The folder of a run: the wanted one, or one named by the UTC time. Nothing is made.

    Raises:
        Problem: The wanted folder is not empty.
    """
    if wanted is not None:
        out = wanted.absolute()
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise Problem(f"--out {wanted}: not an empty folder; name another or remove it", 2)
        return out
    now = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H-%M-%SZ")
    out, count = RUNS / now, 1
    while out.exists():
        count += 1
        out = RUNS / f"{now}_{count}"
    return out
