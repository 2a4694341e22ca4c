"""The maker's own client library for UR arms, built from its public source outside the checkout.

``SURG_URCL`` names the folder of its source, with what CMake has built in `build`:
github.com/UniversalRobots/Universal_Robots_Client_Library, ``cmake -B build && make -C build``. Its
tests for a simulator are built where ``BUILDING_TESTS`` and ``INTEGRATION_TESTS`` are on.
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
    return _run(Path("examples", name), [address, *words], ".", timeout)


def its_tests(name: str, address: str, leave_out: tuple[str, ...], timeout: float) -> str:
    """Run one of its programs of tests against an arm; what it says.

    Raises:
        AssertionError: One of them fails.
    """
    words = ["--robot_ip", address, "--headless", "true"]
    return _run(
        Path("tests", name), [*words, f"--gtest_filter=-{':'.join(leave_out)}"], "tests", timeout
    )


def _run(program: Path, words: list[str], folder: str, timeout: float) -> str:
    name, source = program.name, Path(os.environ.get(VARIABLE, ""))
    program = source / "build" / program
    if not os.environ.get(VARIABLE) or not program.is_file():
        pytest.skip(f"missing: {VARIABLE}: folder of the UR client library, with {program}")
    done = subprocess.run(
        [str(program), *words],
        cwd=source / folder,
        env=os.environ | {"ROBOT_MODEL": "ur5e"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        timeout=timeout,
    )
    print(done.stdout[-4000:])
    assert done.returncode == 0, f"{name}: {done.returncode}"
    return done.stdout
