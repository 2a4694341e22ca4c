"""The maker's own client library for UR arms, built from its public source outside the checkout.

``SURG_URCL`` names the folder of its source, with what CMake has built in `build`:
github.com/UniversalRobots/Universal_Robots_Client_Library, ``cmake -B build && make -C build``.
"""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

VARIABLE = "SURG_URCL"


def example(name: str, address: str, *words: str, timeout: float = 120.0) -> str:
    """Run one of its examples against an arm; what it says.

    Raises:
        AssertionError: It fails.
    """
    source = Path(os.environ.get(VARIABLE, ""))
    program = source / "build" / "examples" / name
    if not os.environ.get(VARIABLE) or not program.is_file():
        pytest.skip(f"missing: {VARIABLE}: folder of the UR client library, with build/examples")
    done = subprocess.run(
        [str(program), address, *words],
        cwd=source,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        timeout=timeout,
    )
    print(done.stdout[-4000:])
    assert done.returncode == 0, f"{name}: {done.returncode}"
    return done.stdout
