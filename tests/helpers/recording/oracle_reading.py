"""Runs a reader of exported data sets in the environment of a version of lerobot."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from helpers.policy import lerobot_venv


def run(version: str, script: str, *words: object, home: Path) -> list[dict[str, Any]]:
    """What a script beside this file says: a JSON object per line, the first of them versions.

    Args:
        version: Of lerobot; names the environment.
        script: Its file.
        words: Its arguments.
        home: A folder for what the libraries keep.
    """
    python = lerobot_venv.python(version)
    env = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    env.update(HF_HUB_OFFLINE="1", HF_HOME=str(home / "hf"), HF_DATASETS_OFFLINE="1")
    argv = [str(python), str(Path(__file__).with_name(script)), *map(str, words)]
    done = subprocess.run(argv, env=env, capture_output=True, text=True, timeout=1800, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    versions, *found = [
        json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")
    ]
    print(", ".join(f"{name} {value}" for name, value in versions.items()), file=sys.stderr)
    return [versions, *found]
