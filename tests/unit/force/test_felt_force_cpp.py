"""What the hand on a Lambda.7 feels ends in time, on an exact clock: silence, clutch, pause."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from surg_cli.host import paths

CODE = paths.ROOT / "src" / "surg_lambda7" / "src"
REPLAY = paths.ROOT / "tests" / "helpers" / "force" / "felt_force_replay.cpp"
LIMIT_S = 0.050
"""From the last force that may be felt, or the word that none may be, to no force."""
CASES = 100


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("felt") / "replay"
    sources = [str(REPLAY), str(CODE / "felt_force.cpp"), str(CODE / "haptics.cpp")]
    flags = ["-std=c++17", "-O1", f"-I{CODE}", "-isystem/usr/include/eigen3"]
    subprocess.run(["c++", *flags, *sources, "-o", str(made)], check=True)
    return made


def forces(program: Path, taken: list[tuple[float, float, bool]], steps: np.ndarray) -> np.ndarray:
    """Force on the handle (N,) [N] at steps [s] of a still hand; `taken`: time, force, allowed."""
    events = [(t, f"take {t!r} {force!r} 0 0 {int(may)}") for t, force, may in taken]
    events += [(float(t), f"step {float(t)!r} 0.01 0.02 0.03") for t in steps]
    lines = "\n".join(line for _, line in sorted(events, key=lambda event: event[0]))
    done = subprocess.run([str(program)], input=lines, capture_output=True, text=True, check=True)
    return np.array([float(line.split()[0]) for line in done.stdout.splitlines()])


@pytest.mark.parametrize("ends_by", ["silence", "clutch or pause"])
def test_the_force_is_gone_in_fifty_milliseconds(program: Path, ends_by: str) -> None:
    """Forces come at 100 to 500 Hz and end at any phase of the device's cycle of 1 ms."""
    rng = np.random.default_rng(24)
    longest = 0.0
    for _ in range(CASES):
        end, period = rng.uniform(1.0, 1.1), rng.uniform(0.002, 0.010)
        size = rng.uniform(0.5, 5.0)
        taken = [(float(t), float(size), True) for t in np.arange(0.0, end, period)]
        last = taken[-1][0]
        if ends_by != "silence":  # the word comes, and forces go on coming
            taken += [(float(t), float(size), False) for t in np.arange(end, end + 0.3, period)]
            last = end
        steps = np.arange(rng.uniform(0, 1e-3), end + 0.3, 1e-3)
        found = np.abs(forces(program, taken, steps))
        assert found[steps < last].max() > 0.4, "felt before"
        felt = steps[found > 0.0]
        longest = max(longest, float(felt[-1]) + 1e-3 - last)  # until the next step
        assert np.diff(found[steps > last + 0.021]).max() <= 0.0, "it only falls"
    print(f"{ends_by}: {CASES} cases, no force after {1e3 * longest:.1f} ms")
    assert longest <= LIMIT_S


def test_nothing_is_felt_before_the_first_word_and_after_a_cycle_that_was_late(
    program: Path,
) -> None:
    steps = np.arange(0.0, 0.5, 1e-3)
    assert (forces(program, [], steps) == 0.0).all()
    assert (forces(program, [(0.0, 3.0, False)], steps) == 0.0).all()
    taken = [(float(t), 3.0, True) for t in np.arange(0.0, 1.0, 2e-3)]
    late = np.concatenate([np.arange(0.0, 1.0, 1e-3), [1.2, 1.201]])  # the device's loop stood
    assert forces(program, taken, late)[-1] == 0.0
