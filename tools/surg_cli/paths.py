"""Where things lie in a checkout."""

from __future__ import annotations

import hashlib
import os
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
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
    """Replace a file in one step, so that a reader sees the old or the new text, never half.

    Args:
        path: The file; its folder is made when missing.
        text: The new content.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    with os.fdopen(handle, "w", encoding="utf-8") as stream:
        stream.write(text)
    os.replace(name, path)


def file_digest(path: Path) -> str:
    """SHA-256 of a file's bytes, in hex."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
