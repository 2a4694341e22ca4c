"""A bag of ROS 1 as one of ROS 2, by the program of the library ``rosbags``."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


def twin(bag: Path, folder: Path, storage: str, *words: str) -> Path:
    """The same bag in ROS 2, by the library's own program."""
    program = Path(sys.executable).with_name("rosbags-convert")
    stored = ["--dst-storage", storage, *words]
    argv = [program, "--src", bag, "--dst", folder / bag.stem, *stored]
    subprocess.run(argv, check=True, capture_output=True)
    return folder / bag.stem
