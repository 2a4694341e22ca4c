"""A limit for every test of links and emulators: one that hangs fails by itself."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import pytest

LONGEST = 1200.0 if os.environ.get("SURG_TEST_FULL", "") not in ("", "0") else 60.0
"""[s]"""


@pytest.fixture(autouse=True)
def time_limit() -> Iterator[None]:
    """For every test of a folder whose conftest imports this."""

    def hangs(number: int, frame: object) -> None:
        raise TimeoutError(f"the test has not ended within {LONGEST:.0f} s")

    before = signal.signal(signal.SIGALRM, hangs)
    signal.setitimer(signal.ITIMER_REAL, LONGEST)
    yield
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    signal.signal(signal.SIGALRM, before)
