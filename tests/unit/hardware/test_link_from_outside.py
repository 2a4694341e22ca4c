"""An arm from outside the tree: a folder with ``driver.py``, found by path, run by the platform."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

import surg_core
from helpers.hardware.emulated_cell import emulated_cell
from surg_hardware import adapter_driver, link_node, link_programs
from surg_hardware import driver_datagrams as wire
from surg_hardware.arm_driver import RobotRefused
from surg_hardware.conditions import Condition
from surg_hardware.driver_settings import DriverSettings
from surg_hardware.driver_start import start_driver

DRIVER = '''"""An arm that follows its commands exactly; it lives in this process."""

import time

from surg_hardware.conditions import READY
from surg_hardware.robot_adapter import ArmIdentity, ArmState, RobotAdapter


class Driver(RobotAdapter):
    """It wants to know its joints: settings.joints."""

    cycle = 0.002

    def __init__(self, address, options):
        super().__init__(address, options)
        if "joints" not in options:
            raise ValueError("settings.joints: is missing; allowed is a number of joints")
        self.q = [0.0] * int(options["joints"])
        self.qd = list(self.q)
        self.moving = False

    def connect(self):
        self.next = time.monotonic()

    def state(self):
        self.next += self.cycle
        time.sleep(max(0.0, self.next - time.monotonic()))
        self.q = [q + self.cycle * qd for q, qd in zip(self.q, self.qd)]
        return ArmState(time.monotonic(), tuple(self.q), tuple(self.qd), READY, self.moving)

    def identity(self):
        return ArmIdentity("my_arm", (1, 0, 0, 0.1, 0, 1, 0, 0.2, 0, 0, 1, 0.3), "17")

    def send(self, qd):
        self.moving, self.qd = True, list(qd)

    def stop(self):
        self.moving, self.qd = False, [0.0] * len(self.q)

    def close(self):
        pass
'''
LINK = {
    "format": "surg_link/1", "name": "my_link", "link_timeout": 0.04, "link_lag": 0.0,
    "acceleration": 0.9, "dead_man": 0.04, "stop_deceleration": 10.0, "driver": "my_driver",
    "settings": {"joints": 6},
}  # fmt: skip


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    """A cell, a link and its driver in a folder of their own; returns the cell's file."""
    (tmp_path / "my_driver").mkdir()
    (tmp_path / "my_driver" / "driver.py").write_text(DRIVER, "utf-8")
    (tmp_path / "my_link.yaml").write_text(yaml.safe_dump(LINK), "utf-8")
    edit = {"link": "../my_link.yaml"}
    return emulated_cell(tmp_path, "127.31.7.7", edit=lambda arm: arm.update(edit)) / "cell.yaml"


class Running:
    """The driver's process, and the node's side of its socket."""

    def __init__(self, arm: surg_core.Arm) -> None:
        self.process, self._node = start_driver(arm)
        self._node.settimeout(0.5)
        self.state: wire.StateDatagram | None = None
        self.identity: wire.IdentityDatagram | None = None

    def until(self, condition: Condition, qd: float, seconds: float = 10.0) -> None:
        """Command a velocity for each state until the robot's condition is reached."""
        end = time.monotonic() + seconds
        while self.state is None or self.state.status.condition is not condition:
            assert time.monotonic() < end, self.state
            self.turn(qd)

    def turn(self, qd: float | None) -> None:
        """Hear one thing of the driver; answer a state."""
        try:
            said = wire.decode_from_driver(self._node.recv(wire.LONGEST))
        except TimeoutError:
            return
        if isinstance(said, wire.IdentityDatagram):
            self.identity = said
        elif isinstance(said, wire.StateDatagram):
            self.state = said
            if qd is not None:
                self._node.send(wire.CommandDatagram(said.stamp_ns, (qd,) * 6).pack())

    def ask(self, word: str) -> None:
        self._node.send(wire.RequestDatagram(word, False).pack())


@pytest.fixture
def running(cell: Path) -> Iterator[Running]:
    made = Running(surg_core.load_cell(cell).arms["PSM1"])
    yield made
    made.process.terminate()
    assert made.process.wait(5.0) == 0


def test_an_arm_from_outside_is_driven_like_the_others(running: Running) -> None:
    running.until(Condition.READY, 0.0)
    end = time.monotonic() + 2.1
    while time.monotonic() < end:
        running.turn(0.0)
    assert running.identity is not None and running.identity.said.serial == "17"
    running.ask("start")
    running.until(Condition.ACTIVE, 0.0)
    assert running.state is not None
    at = running.state.q[0]
    for _ in range(100):
        running.turn(0.1)
    assert 0.005 < running.state.q[0] - at < 0.05
    for _ in range(100):  # a silent controller
        running.turn(None)
    assert running.state.status.condition is Condition.READY
    assert running.state.qd == (0.0,) * 6 and "40 ms" in running.state.status.fault


def test_what_is_missing_is_named(cell: Path, tmp_path: Path) -> None:
    def refused(change: dict[str, object]) -> str:
        (tmp_path / "my_link.yaml").write_text(yaml.safe_dump({**LINK, **change}), "utf-8")
        with pytest.raises((RobotRefused, surg_core.ConfigError)) as caught:
            settings = link_node.driver_settings(surg_core.load_cell(cell).arms["PSM1"])
            adapter_driver.made(settings, socket.socket())
        return str(caught.value)

    assert "settings.joints" in refused({"settings": {}})
    assert "no_such" in refused({"driver": "no_such"})
    (tmp_path / "my_link.yaml").write_text(
        yaml.safe_dump({key: value for key, value in LINK.items() if key != "driver"}), "utf-8"
    )
    with pytest.raises(surg_core.ConfigError, match="driver: FOLDER"):
        link_node.driver_settings(surg_core.load_cell(cell).arms["PSM1"])


@pytest.mark.parametrize("text", ["x = ", "x = 1", "class Driver: pass"])
def test_a_file_without_a_driver_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "driver.py").write_text(text, "utf-8")
    settings = DriverSettings("127.0.0.1", 40, (), (), 0.04, 10.0, str(tmp_path))
    with pytest.raises(RobotRefused, match=r"driver\.py"):
        adapter_driver.made(settings, socket.socket())


def test_packages_of_a_driver_get_an_environment_of_its_own(cell: Path, tmp_path: Path) -> None:
    arm = surg_core.load_cell(cell).arms["PSM1"]
    assert link_programs.requirements(arm.link, arm.driver) is None
    (tmp_path / "my_driver" / link_programs.REQUIREMENTS).write_text("", "utf-8")
    with pytest.raises(link_programs.NoProgram, match=r"\.venv-link-my_driver"):
        link_programs.driver_words(arm.link, arm.driver)
