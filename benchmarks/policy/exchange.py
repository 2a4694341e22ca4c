"""What every way over the wire carries, and how its time is taken.

A way is a program with two roles. The *policy* answers each observation with a chunk that repeats
the newest byte of both pictures, so that nothing can answer without having received all. The
*robot* sends and waits; it reads how many rounds to make from its standard input, a number per
line, and writes the times [ms] of each line's rounds as JSON.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Pictures = dict[str, NDArray[np.uint8]]
LEFT, RIGHT = "observation.images.endoscope.left", "observation.images.endoscope.right"
STATE = "observation.state"
ROWS, COLUMNS = 50, 8


def pictures() -> Pictures:
    """Stereo 640x480, RGB, without patterns that anything could make use of."""
    rng = np.random.default_rng(7)
    return {key: rng.integers(0, 256, (480, 640, 3), dtype=np.uint8) for key in (LEFT, RIGHT)}


def state() -> NDArray[np.float32]:
    """The state of one arm."""
    return np.linspace(0.0, 1.0, 9, dtype=np.float32)


def answer(left: NDArray[np.uint8], right: NDArray[np.uint8]) -> NDArray[np.float32]:
    """The chunk that shows that both pictures are here."""
    chunk = np.zeros((ROWS, COLUMNS), np.float32)
    chunk[0, 0], chunk[-1, -1] = left[-1, -1, -1], right[-1, -1, -1]
    return chunk


def robot(
    ask: Callable[[Pictures, NDArray[np.float32]], NDArray[np.float32]],
    idle: Callable[[], None] = lambda: None,
) -> None:
    """Play the robot's role until standard input ends.

    Args:
        ask: Sends pictures and state, returns the chunk that answers them.
        idle: Called while the others have their turn; returns when there is a line to read.
    """
    seen, at = pictures(), state()
    count = 0
    while True:
        idle()
        line = sys.stdin.readline()
        if not line:
            return
        times = []
        for _ in range(int(line)):
            count += 1
            seen[LEFT][-1, -1, -1] = count % 256
            seen[RIGHT][-1, -1, -1] = (3 * count) % 256
            begun = time.perf_counter()
            chunk = ask(seen, at)
            times.append(1e3 * (time.perf_counter() - begun))
            good = chunk.shape == (ROWS, COLUMNS) and chunk.dtype == np.float32
            if not good or chunk[0, 0] != count % 256 or chunk[-1, -1] != (3 * count) % 256:
                sys.exit(f"a wrong answer to round {count}")
        print(json.dumps(times), flush=True)


def main(as_robot: Callable[[str, str], None], as_policy: Callable[[str, str], None]) -> None:
    """Run one of the two roles: `PROGRAM robot|policy ADDRESS [FOLDER OF KEYS]`."""
    role, address, *keys = sys.argv[1:]
    {"robot": as_robot, "policy": as_policy}[role](address, keys[0] if keys else "")
