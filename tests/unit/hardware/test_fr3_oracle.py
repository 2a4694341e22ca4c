"""Our FR3 link drives somebody else's FR3: PyPI's franky-sim.

By the maker's pylibfranka in real time: it has no limits of its own, so acceleration and jerk are
judged on the wire. And with controller and link on a made-up clock: its joints in MuJoCo take the
place of the emulator's. ``SURG_TEST_FULL=1`` plays the whole bundled motion there.
"""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

import surg_core
from helpers.hardware import client_venvs
from helpers.hardware.chain_player import play
from helpers.hardware.emulated_ur import SOURCES
from helpers.hardware.franka_chain import Chain
from helpers.hardware.other_fr3 import FRANKY_SIM, joints, running
from helpers.results import hardware_results as page
from surg_cli.host import paths
from surg_emulators.franka.generator_motion import GeneratorMotion
from surg_hardware.conditions import Condition
from surg_teleop.playback.motion_player import PlayerStage

pytestmark = pytest.mark.oracle
CLIENT = paths.ROOT / "tests" / "helpers" / "hardware" / "fr3_adapter_client.py"
BUNDLED = paths.ROOT / "src/surg_teleop/motions/bundled.csv"
FULL = os.environ.get("SURG_TEST_FULL", "") not in ("", "0")
SECONDS = 60.0 if FULL else 3.0
SHARES = np.array((0.5, -0.4, 0.6, 0.8, -1.0, -0.9, 1.0))


@pytest.fixture(scope="module")
def pythons() -> tuple[Path, Path]:
    """Of the library and of the simulator; making them takes longer than a test may."""
    return client_venvs.python("pylibfranka==0.21.3"), client_venvs.python(FRANKY_SIM)


def test_our_fr3_link_drives_franky_sim(pythons: tuple[Path, Path], tmp_path: Path) -> None:
    python, simulator = pythons
    arm = surg_core.load_cell(paths.CELLS / "emulated_fr3").arms["PSM1"]
    with running(simulator, tmp_path / "log", arm.robot.home) as address:
        done = subprocess.run(
            [str(python), str(CLIENT), address],
            capture_output=True,
            text=True,
            timeout=120,
            env={**os.environ, "PYTHONPATH": str(SOURCES)},
        )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    print({key: found[key] for key in ("way", "back", "acceleration", "jerk")})
    # A swing by 0.2 rad/s at 0.5 Hz is 2 * 0.2 / pi; its velocity controller loses 3 %.
    assert found["way"] == pytest.approx((np.abs(SHARES) * 0.4 / np.pi).tolist(), rel=0.08)
    assert found["back"] < 0.02  # rad; the simulator creeps
    assert found["acceleration"] <= 1.0 and found["jerk"] <= 1.0
    assert not found["obeys"] and found["condition"] == Condition.READY
    rows = np.array(found["flange"]).reshape(3, 4)
    ours = arm.chain.forward(np.array(found["q"]))
    away = np.linalg.norm(rows[:, 3] - ours[:3, 3])
    print(f"flange: {1e3 * away:.3f} mm from ours")
    assert away < 5e-4
    assert found["mass"] == pytest.approx(0.73)


def test_the_bundled_motion_keeps_the_pivot_with_somebody_elses_joints(
    pythons: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    arm = surg_core.load_cell(paths.CELLS / "emulated_fr3").arms["PSM1"]
    with joints(pythons[1], arm.robot.home) as settle:
        monkeypatch.setattr(GeneratorMotion, "settle", settle)
        played = play(Chain("fr3", monkeypatch), BUNDLED, duration=SECONDS)
    assert played.stage is PlayerStage.DONE, played.reason
    off = 1e3 * played.deviation
    said = f"mean {off.mean():.4f}, max {off.max():.3f} mm"
    page.note(page.FRANKY_CHAIN, 1, said)
    assert off.max() <= 0.5
