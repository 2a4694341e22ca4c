"""Our FR3 link drives somebody else's joints: those of PyPI's franky-sim in MuJoCo.

Controller and link are on a made-up clock. ``SURG_TEST_FULL=1`` plays the whole bundled motion. In
real time, by the maker's library: `test_franka_processes.py`.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

import surg_core
from helpers.hardware import client_venvs
from helpers.hardware.chain_player import play
from helpers.hardware.franka_chain import Chain
from helpers.hardware.other_fr3 import FRANKY_SIM, joints
from helpers.results import hardware_results as page
from surg_cli.host import paths
from surg_emulators.franka.generator_motion import GeneratorMotion
from surg_teleop.playback.motion_player import PlayerStage

pytestmark = pytest.mark.oracle
BUNDLED = paths.ROOT / "src/surg_teleop/motions/bundled.csv"
FULL = os.environ.get("SURG_TEST_FULL", "") not in ("", "0")
SECONDS = 60.0 if FULL else 3.0


@pytest.fixture(scope="module")
def simulator() -> Path:
    """Its Python; making it takes longer than a test may."""
    return client_venvs.python(FRANKY_SIM)


def test_the_bundled_motion_keeps_the_pivot_with_somebody_elses_joints(
    simulator: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm = surg_core.load_cell(paths.CELLS / "emulated_fr3").arms["PSM1"]
    with joints(simulator, arm.robot.home) as settle:
        monkeypatch.setattr(GeneratorMotion, "settle", settle)
        played = play(Chain("fr3", monkeypatch), BUNDLED, duration=SECONDS)
    assert played.stage is PlayerStage.DONE, played.reason
    off = 1e3 * played.deviation
    said = f"mean {off.mean():.4f}, max {off.max():.3f} mm"
    page.note(page.FRANKY_CHAIN, 1, said)
    assert off.max() <= 0.5
