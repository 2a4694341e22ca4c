"""The check-up through a driver: what its words mean, line by line."""

from __future__ import annotations

import pytest

import surg_core
from surg_cli.host import paths
from surg_hardware import driver_checkup
from surg_hardware.checkup import Finding
from surg_hardware.conditions import OFFLINE, Condition, Reading, franka_reading
from surg_hardware.driver_checkup import Heard
from surg_hardware.driver_datagrams import IdentityDatagram, NoticeDatagram, StateDatagram
from surg_hardware.robot_adapter import ArmIdentity
from surg_hardware.robot_link import Status

ARM = surg_core.load_cell(paths.CELLS / "emulated_fr3").arms["PSM1"]
ZERO = (0.0,) * 7
READY = Reading(Condition.READY, "", "")


def said(reading: Reading = READY, q: tuple[float, ...] = ZERO, number: int = 0) -> StateDatagram:
    """A state of the driver; a robot that is ready says that it is not started."""
    fault = reading.text or "the robot is not started: ./surg robot CELL start"
    return StateDatagram(
        round(2e6 * number), number, q, q, Status(reading.condition, fault, False, 0, 1.0)
    )


def identity(model: str = "fr3", mass: float = 0.0, shift: float = 0.0) -> IdentityDatagram:
    """Of an arm at its home; ``shift``: of its flange [m]."""
    home = ARM.robot.home
    flange = ARM.chain.forward(home)[:3].copy()
    flange[0, 3] += shift
    said = ArmIdentity(model, tuple(flange.ravel().tolist()), mass=mass)
    return IdentityDatagram(tuple(home.tolist()), said)


def bad(*words: object, refusal: str = "") -> list[Finding]:
    heard = Heard(refusal=refusal)
    for n, each in enumerate(words):
        heard.take(each, 0.002 * n)
    return [line for line in driver_checkup.findings(ARM, heard) if line.good is False]


def test_nothing_is_wrong_with_the_cells_own_arm() -> None:
    heard = Heard()
    for n in range(50):
        heard.take(said(number=n), 0.002 * n)
    heard.take(identity(), 0.1)
    lines = driver_checkup.findings(ARM, heard)
    assert not [line for line in lines if line.good is False]
    names = {"condition", "robot", "hardware.payload.mass", "forward kinematics", "states"}
    assert names <= {line.what for line in lines}


@pytest.mark.parametrize(
    ("words", "what", "cure"),
    [
        ([said(franka_reading("other", []))], "condition", "Desk"),
        ([said(franka_reading("user_stopped", []))], "condition", "release"),
        ([said(franka_reading("guiding", []))], "condition", "end it"),
        ([said(franka_reading("reflex", ["joint_reflex"]))], "condition", "recover"),
        ([said(OFFLINE, ())], "condition", "cable"),
        ([said(), identity(model="panda")], "robot", "name the YAML"),
        ([said(), identity(mass=0.9)], "hardware.payload.mass", "set it"),
        ([said(), identity(shift=0.001)], "forward kinematics", "kinematics"),
        ([said(), NoticeDatagram("7 % of the commands are lost")], "notice", "page"),
    ],
)
def test_what_is_wrong_is_named_with_its_cure(words: list[object], what: str, cure: str) -> None:
    (found,) = bad(*words)
    assert found.what == what and found.text and cure in found.cure


@pytest.mark.parametrize("refusal", ["127.0.0.1: another driver drives this robot", ""])
def test_a_driver_that_refuses_or_says_nothing_is_one_finding(refusal: str) -> None:
    words = [] if not refusal else [said()]
    (found,) = bad(*words, refusal=refusal or "the driver said nothing")
    assert found.what == "hardware.address" and found.cure
    assert found.text.endswith(refusal.removeprefix("127.0.0.1: ") or "nothing")
