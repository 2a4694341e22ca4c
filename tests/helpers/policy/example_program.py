"""Runs the bgr learner as its users do: without the platform."""

from __future__ import annotations

import subprocess
import sys

from surg_cli.host import paths


def said_alone(program: str) -> str:
    """What a program prints that runs beside surg_learn without the workspace's environment."""
    done = subprocess.run(
        [sys.executable, "-s", "-c", program],
        cwd=paths.ROOT / "src/surg_learn/src",
        capture_output=True,
        text=True,
        check=True,
        env={"PATH": "/usr/bin:/bin"},
    )
    return done.stdout.strip()
