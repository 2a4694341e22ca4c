"""The maker's own client library for UR arms, built from its public source outside the checkout.

``SURG_URCL`` names the folder of its source, with what CMake has built in `build`:
github.com/UniversalRobots/Universal_Robots_Client_Library, ``cmake -B build && make -C build``. Its
tests for a simulator are built where ``BUILDING_TESTS``, ``INTEGRATION_TESTS`` and
``POLYSCOPE_X_TESTS_WITH_REMOTE_CONTROL`` are on.
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


def its_tests(name: str) -> list[str]:
    """Names of the tests of one of its programs."""
    found, case = [], ""
    for line in _run(Path("tests", name), ["--gtest_list_tests"], "tests", 60.0).splitlines():
        if line.startswith("  "):
            found.append(case + line.split()[0])
        elif line.endswith("."):
            case = line
    return found


def its_test(name: str, test: str, address: str, timeout: float) -> bool:
    """Run one test alone, as its CTest does; False: it skips itself.

    Raises:
        AssertionError: It fails.
        TimeoutExpired: It does not end.
    """
    words = ["--robot_ip", address, "--headless", "true", f"--gtest_filter={test}"]
    return "[  SKIPPED ]" not in _run(Path("tests", name), words, "tests", timeout)


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
