"""Independent clients of PyPI drive the emulated UR arm.

`ur_rtde` speaks RTDE, dashboard and scripts, `urx` the secondary interface.
"""

from pathlib import Path

import pytest

from helpers.hardware import client_venvs, emulated_ur

pytestmark = pytest.mark.oracle
HOME_POSE = [0.4919, -0.1333, 0.4879]
"""The flange of a UR5e at q = (0, -pi/2, -pi/2, -pi/2, pi/2, 0), in UR's base [m]."""


def test_ur_rtde_drives_the_emulated_arm(tmp_path: Path) -> None:
    with emulated_ur.program(tmp_path / "emulator.log") as address:
        found = client_venvs.figures("ur_rtde==1.6.5", address, "ur_rtde_client.py", "29990")
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


def test_urx_drives_the_emulated_arm_by_the_secondary_interface(tmp_path: Path) -> None:
    with emulated_ur.program(tmp_path / "emulator.log") as address:
        found = client_venvs.figures("urx==0.11.0", address, "urx_client.py")
    assert found["joints"] == pytest.approx([0.0, -1.5708, -1.5708, -1.5708, 1.5708, 0.0])
    assert found["place"] == pytest.approx(HOME_POSE, abs=1e-4)
    assert found["move_error"] < 1e-6
    assert found["rate"] == pytest.approx(0.2, abs=0.06)  # by two states, each up to 0.1 s old
