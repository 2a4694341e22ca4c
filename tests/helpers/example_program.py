"""Runs the examples as their users do: beside nothing of the platform."""

from __future__ import annotations

import subprocess
import sys

from surg_cli.host import paths


def said_alone(program: str) -> str:
    """What a program prints that sees the folder of examples and no environment of ours."""
    done = subprocess.run(
        [sys.executable, "-s", "-c", program],
        cwd=paths.ROOT / "examples",
        capture_output=True,
        text=True,
        check=True,
        env={"PATH": "/usr/bin:/bin"},
    )
    return done.stdout.strip()
