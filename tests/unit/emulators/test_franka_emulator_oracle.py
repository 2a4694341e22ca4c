"""The maker's own library drives the emulated Franka arms.

PyPI's `panda-python` brings libfranka 0.9.2 for the FER, `pylibfranka` 0.21.3 for the FR3.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.hardware import client_venvs, emulated_franka
from surg_emulators.franka.franka_errors import Error
from surg_emulators.franka.franka_kinematics import flange, from_columns
from surg_emulators.franka.franka_robots import HOME

pytestmark = pytest.mark.oracle
PANDA, PYLIBFRANKA = "panda-python==1.1.1", "pylibfranka==0.21.3"
NAMES = [error.name for error in Error]


def figures(kind: str, requirement: str, client: str, log: Path) -> dict[str, Any]:
    """What a client prints of an emulated arm."""
    with emulated_franka.program(kind, log) as address:
        return client_venvs.figures(requirement, address, client, *NAMES)


def check(found: dict[str, Any], accuracy: float) -> None:
    """What both libraries must see."""
    assert found["q"] == pytest.approx(HOME, abs=accuracy)
    assert found["said"] == ""
    assert found["way"] == pytest.approx([0.2, *[0.0] * 6], abs=1e-5)
    settings = found["settings"]
    load = [0.7, 0.01, 0.02, 0.03, 0.1, 0.0, 0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 0.3]
    assert settings["load"] == pytest.approx(load, abs=accuracy)
    frame, before = from_columns(settings["frame"]), from_columns(settings["before"])
    assert frame[:3, 3] == pytest.approx((0.01, 0.02, 0.1), abs=accuracy)
    assert from_columns(settings["after"]) == pytest.approx(before @ frame, abs=accuracy)
    for name, said in found["errors"].items():  # named by the library, from the flag's number
        assert f'["{name}"]' in said.lower(), (name, said)
    assert len(found["errors"]) == len(NAMES)
    assert "communication_constraints_violation" in found["burst"]
    assert "velocity_discontinuity" in found["step"]
    assert "current mode" in found["in_reflex"] and "Reflex" in found["in_reflex"]
    assert "User Stop" in found["user_stop"]
    modes = [found[name].removeprefix("k") for name in ("user_stopped", "released", "guided")]
    assert modes == ["UserStopped", "Idle", "Guiding"]


def test_libfranka_092_drives_the_emulated_fer(tmp_path: Path) -> None:
    found = figures("fer", PANDA, "panda_python_client.py", tmp_path / "emulator.log")
    check(found, 1e-9)
    assert found["version"] == 5
    assert found["limited_step"] == ""
    assert "model library" in found["model"]


def test_libfranka_021_drives_the_emulated_fr3(tmp_path: Path) -> None:
    found = figures("fr3", PYLIBFRANKA, "pylibfranka_client.py", tmp_path / "emulator.log")
    check(found, 1e-6)
    frame = from_columns(found["settings"]["frame"])
    jacobian = np.array(found["jacobian"]).reshape(7, 6).T  # from the model that the arm handed out
    step = 1e-6
    for joint in range(7):
        shift = np.eye(7)[joint] * step
        ends = flange([np.array(found["q"]) + shift, np.array(found["q"]) - shift]) @ frame
        velocity = (ends[0] - ends[1])[:3, 3] / (2.0 * step)
        assert jacobian[:3, joint] == pytest.approx(velocity, abs=1e-5)


@pytest.mark.parametrize(
    ("kind", "requirement", "program"),
    [
        (
            "fr3",
            PANDA,
            "from panda_py import libfranka as f; f.Robot('ADDRESS', f.RealtimeConfig.kIgnore)",
        ),
        (
            "fer",
            PYLIBFRANKA,
            "import pylibfranka as f; f.Robot('ADDRESS', f.RealtimeConfig.kIgnore)",
        ),
    ],
)
def test_the_library_of_the_other_arm_is_told_the_version(
    kind: str, requirement: str, program: str, tmp_path: Path
) -> None:
    with emulated_franka.program(kind, tmp_path / "emulator.log") as address:
        done = client_venvs.call(requirement, address, "-c", program)
    assert done.returncode != 0
    said = done.stderr.splitlines()[-1].lower()
    print(said)
    assert "incompatible" in said and {"fer": "5", "fr3": "10"}[kind] in said
