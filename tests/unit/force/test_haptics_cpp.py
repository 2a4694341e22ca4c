"""The Lambda.7 node's feedback in C++ gives the forces of `surg_core.force.haptics`."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from surg_cli.host import paths
from surg_core.force.haptics import HapticFeedback, HapticLimits

CODE = paths.ROOT / "src" / "surg_lambda7" / "src"
REPLAY = paths.ROOT / "tests" / "helpers" / "force" / "haptics_replay.cpp"


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("haptics") / "replay"
    sources = [str(REPLAY), str(CODE / "haptics.cpp")]
    flags = ["-std=c++17", "-O0", f"-I{CODE}", "-isystem/usr/include/eigen3"]
    subprocess.run(["c++", *flags, *sources, "-o", str(made)], check=True)
    return made


@pytest.mark.parametrize("seed", range(3))
def test_both_give_the_same_forces(program: Path, seed: int) -> None:
    """A hand against a late wall, with silence, clutches, numbers that are none, uneven steps."""
    rng = np.random.default_rng(seed)
    n, limits = 3000, HapticLimits(max_force=4.0, scale=1.5)
    t = np.cumsum(rng.uniform(5e-4, 2e-3, n))
    place = 0.02 * np.sin(np.outer(t, [6.0, 9.0, 13.0]) + rng.uniform(0, 6, 3))
    force = -800.0 * np.maximum(np.roll(place, 30, axis=0), 0.0) + rng.normal(0, 0.3, (n, 3))
    age = np.where(rng.random(n) < 0.98, 0.004, 0.05)
    age[1000:1040] = 0.03
    allowed = np.ones(n, dtype=int)
    allowed[1500:1600] = 0
    force[2000], place[2500, 1] = np.nan, np.nan
    dt = np.diff(t, prepend=t[0] - 1e-3)
    feedback = HapticFeedback(limits)
    expected = [
        feedback.step(force[i], age[i], place[i], bool(allowed[i]), dt[i]) for i in range(n)
    ]
    lines = "\n".join(
        " ".join(map(repr, map(float, [*force[i], age[i], *place[i]])))
        + f" {allowed[i]} {float(dt[i])!r}"
        for i in range(n)
    )
    done = subprocess.run(
        [str(program), "4.0", "1.5"], input=lines, capture_output=True, text=True, check=True
    )
    found = np.array([line.split() for line in done.stdout.splitlines()], dtype=float)
    assert len(found) == n and np.abs(found).max() > 2.0
    np.testing.assert_allclose(found, np.array(expected), rtol=0.0, atol=1e-9)
