"""An independent client, PyPI's ur_rtde, drives the emulated UR arm: modes, motion, stops."""

import json
import subprocess
from pathlib import Path

import pytest

from helpers.hardware import emulated_ur, ur_rtde_venv
from surg_cli.host import paths

pytestmark = pytest.mark.oracle
CLIENT = paths.ROOT / "tests" / "helpers" / "hardware" / "ur_rtde_client.py"
HOME_POSE = [0.4919, -0.1333, 0.4879]
"""The flange of a UR5e at q = (0, -pi/2, -pi/2, -pi/2, pi/2, 0), in UR's base [m]."""


def test_ur_rtde_drives_the_emulated_arm(tmp_path: Path) -> None:
    python = ur_rtde_venv.python()
    with emulated_ur.program(tmp_path / "emulator.log") as address:
        done = subprocess.run(
            [str(python), str(CLIENT), address, "29990"],
            capture_output=True,
            text=True,
            timeout=120,
            env={},
        )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    print(json.dumps(found, indent=1))
    assert found["robot"] == "Robotmode: RUNNING"
    assert (found["model"], found["serial"]) == ("UR5", "20225500001")
    assert found["remote"] is True
    assert (found["mode"], found["safety"]) == (7, 1)
    assert found["pose"][:3] == pytest.approx(HOME_POSE, abs=1e-4)
    assert found["cycle"] == pytest.approx(0.002, abs=1e-6)
    assert found["speed_error"] < 1e-4  # rad/s, steady
    assert 0.03 < found["servo_late"] < 0.06  # s; its look-ahead alone is 0.03
    assert found["move_error"] < 1e-6  # rad
    assert found["custom_error"] < 1e-6
    stop = found["stop"]
    assert stop["stopped"] and stop["still_stopped"] and stop["unlocked"] and stop["again"]
    assert stop["safety"] == "Safetystatus: PROTECTIVE_STOP"
    assert stop["early"] is True
    assert stop["late"] is False
    assert stop["moved"] < 1e-6  # rad, by unlocking
    assert stop["move_error"] < 1e-6
