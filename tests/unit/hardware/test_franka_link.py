"""The links to FR3 and Panda with a made-up library on a made-up clock: exact in milliseconds."""

from __future__ import annotations

import importlib
import math
import socket
import sys
import time
import types
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from helpers.hardware import fake_libfranka
from helpers.hardware.fake_libfranka import Arm
from surg_emulators.franka.franka_controller import RECOVERY_CYCLES, RobotMode
from surg_emulators.franka.franka_errors import Error
from surg_emulators.franka.franka_kinematics import flange
from surg_emulators.franka.franka_robots import FER
from surg_emulators.franka.franka_robots import FR3 as FR3_ARM
from surg_emulators.franka.generator_motion import DT
from surg_hardware import adapter_driver, arm_driver, robot_link
from surg_hardware import driver_datagrams as wire
from surg_hardware.arm_driver import RobotRefused
from surg_hardware.conditions import Condition
from surg_hardware.driver_checkup import Heard
from surg_hardware.driver_settings import DriverSettings
from surg_hardware.franka.joint_limits import FR3, PANDA
from surg_hardware.franka.versions import refusal

LIBRARIES: dict[str, Callable[[Arm], dict[str, types.ModuleType]]] = {
    "fr3": lambda arm: {"pylibfranka": fake_libfranka.pylibfranka(arm)},
    "panda": lambda arm: {"panda_py": fake_libfranka.panda_py(arm)},
}
LIMITS = {"fr3": FR3, "panda": PANDA}
ARMS = {"fr3": FR3_ARM, "panda": FER}
OPTIONS: dict[str, object] = {
    "collision_torque": [20.0] * 7,
    "collision_force": [25.0] * 6,
    "success_rate": 0.95,
}
SPEED = (0.2, -0.1, 0.05, 0.0, 0.1, -0.2, 0.3)


class Rig:
    """A driver in this thread, with the node's side of its socket."""

    def __init__(self, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
        middle = [0.5 * (joint.lower + joint.upper) for joint in LIMITS[name]]
        self.arm = Arm(ARMS[name], middle)
        for module, made in LIBRARIES[name](self.arm).items():
            monkeypatch.setitem(sys.modules, module, made)
        monkeypatch.delitem(sys.modules, f"surg_hardware.franka.{name}_adapter", raising=False)
        clock = types.SimpleNamespace(
            monotonic=lambda: DT * self.arm.count,
            time_ns=lambda: round(1e9 * DT * self.arm.count),
            sleep=lambda seconds: None,
        )
        monkeypatch.setattr(arm_driver, "time", clock)
        monkeypatch.setattr(adapter_driver, "time", clock)
        monkeypatch.setattr(robot_link, "SETTLED", 0.1)
        self._node, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._node.setblocking(False)
        velocity = tuple(joint.velocity for joint in LIMITS[name])
        settings = DriverSettings(
            "127.0.0.1", 40, velocity, (math.inf,) * 7, 0.02, 6.0, name, OPTIONS
        )
        self.driver = adapter_driver.made(settings, theirs)
        self.driver._connect_first()
        self.status = None
        self.heard = Heard()

    def cycles(
        self, count: int, qd: tuple[float, ...] | None = (0.0,) * 7, age: float = 0.0
    ) -> None:
        """Some milliseconds, with a command every second one; ``age``: of its state [s]."""
        for _ in range(count):
            if qd is not None and self.arm.count % 2 == 0:
                stamp = round(1e6 * self.arm.count - 1e9 * age)
                self._node.send(wire.CommandDatagram(stamp, qd).pack())
            self.driver._turn()
            self._wait_for_the_motion()
            self.heard.read(self._node, 0.0)

    def _wait_for_the_motion(self) -> None:
        """Until panda_py's thread has read its next state or has ended: the clock counts states."""
        adapter: Any = self.driver._adapter
        motion = getattr(adapter, "_motion", None)
        deadline = time.monotonic() + 10.0
        while motion and adapter._answered and motion.is_alive() and adapter._states.empty():
            assert time.monotonic() < deadline, "the motion stands still"
            time.sleep(1e-5)

    @property
    def condition(self) -> Condition:
        return self.newest.status.condition

    @property
    def newest(self) -> wire.StateDatagram:
        assert self.heard.newest is not None
        return self.heard.newest

    def ask(self, word: str, enabled: bool = False) -> None:
        self._node.send(wire.RequestDatagram(word, enabled).pack())
        self.cycles(2)

    def started(self) -> Rig:
        self.cycles(110)
        self.ask("start")
        self.cycles(30)
        assert self.condition is Condition.ACTIVE, self.heard.notices
        return self

    def close(self) -> None:
        self.driver._adapter.close()
        self._node.close()


@pytest.fixture(params=LIBRARIES)
def rig(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Rig]:
    made = Rig(request.param, monkeypatch)
    yield made
    made.close()


def test_it_moves_as_commanded_and_ends_at_rest(rig: Rig) -> None:
    rig.started().cycles(300, SPEED)
    assert rig.arm.dq_d == pytest.approx(SPEED, abs=1e-3)
    rig.cycles(100)
    rig.ask("stop")
    rig.cycles(100)
    assert rig.arm.core.mode is RobotMode.IDLE and rig.arm.ended is not None
    assert rig.arm.ended < 1e-3
    assert rig.condition is Condition.READY and "start" in rig.newest.status.fault
    assert max(rig.arm.excess) <= 0.951


def test_a_stop_from_motion_is_no_step(rig: Rig) -> None:
    rig.started().cycles(300, SPEED)
    rig.ask("stop")
    rig.cycles(200, SPEED)
    assert rig.arm.core.mode is RobotMode.IDLE
    assert rig.arm.ended is not None and rig.arm.ended < 1e-3
    assert max(rig.arm.excess) <= 0.951


def test_a_silent_controller_ends_the_motion_within_20_ms_and_it_latches(rig: Rig) -> None:
    rig.started().cycles(300, SPEED)
    before = rig.arm.count
    while rig.arm.core.mode is RobotMode.MOVE:
        rig.cycles(1, None)
    stopped = rig.arm.count - before
    print(f"at rest after {stopped} ms")
    assert stopped <= 90 and rig.arm.ended is not None and rig.arm.ended < 1e-3
    rig.cycles(200, SPEED)
    assert rig.condition is Condition.READY and max(map(abs, rig.arm.dq_d)) < 1e-9


@pytest.mark.parametrize("age", [0.21, 5.0])
def test_a_command_that_answers_an_old_state_is_ignored(rig: Rig, age: float) -> None:
    """Such as one that was under way when the arm stopped."""
    rig.started().cycles(100, SPEED, age)
    assert rig.arm.dq_d == pytest.approx((0.0,) * 7, abs=1e-9)
    rig.cycles(100, SPEED, 0.1)
    assert rig.arm.dq_d == pytest.approx(SPEED, abs=0.05)


def test_lost_commands_do_not_end_in_a_reflex(rig: Rig) -> None:
    rig.started()
    for k in range(20):
        rig.arm.lose = k % 5
        rig.cycles(37, SPEED if k % 2 else tuple(-v for v in SPEED))
    assert rig.arm.core.mode is RobotMode.MOVE and max(rig.arm.excess) <= 0.96


def test_an_acceleration_that_is_reported_late_changes_nothing(rig: Rig) -> None:
    """franky-sim reports its through a low-pass of 20 ms: the velocity then swung."""
    rig.started().arm.sluggish = 0.95
    fastest = 0.0
    for _ in range(300):
        rig.cycles(1, SPEED)
        fastest = max(fastest, abs(rig.arm.dq_d[6]))
    assert fastest <= SPEED[6] + 1e-3, "it overshoots"
    assert rig.arm.dq_d == pytest.approx(SPEED, abs=1e-3)
    assert rig.arm.core.mode is RobotMode.MOVE and max(rig.arm.excess) <= 0.951


def test_a_reflex_is_named_latches_and_is_recovered(rig: Rig) -> None:
    rig.started().cycles(100, SPEED)
    rig.arm.core.reflex(Error.joint_reflex, "a test")
    rig.cycles(4, SPEED)
    assert rig.condition is Condition.STOPPED
    assert "joint_reflex" in rig.newest.status.fault
    rig.cycles(1200)
    rig.ask("start")
    assert rig.condition is Condition.STOPPED
    rig.ask("recover", enabled=True)
    assert rig.condition is Condition.STOPPED, "a controller that is ENABLED keeps it stopped"
    rig.ask("recover")
    rig.cycles(RECOVERY_CYCLES + 10)
    assert rig.condition is Condition.READY
    rig.ask("start")
    rig.cycles(20)
    assert rig.condition is Condition.ACTIVE, rig.heard.notices


def test_states_come_every_second_cycle_with_the_robots_wrench(rig: Rig) -> None:
    rig.arm.core.push([1.0, 2.0, 3.0, 0.1, 0.2, 0.3])
    rig.cycles(1000)
    assert 480 < len(rig.heard.states) < 520
    assert rig.newest.wrench == (1.0, 2.0, 3.0, 0.1, 0.2, 0.3)


def test_it_says_who_it_is(rig: Rig) -> None:
    core = rig.arm.core
    core.load[:4] = 0.7, 0.0, 0.01, 0.03
    core.NE_T_EE = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.0, 0.0, 0.1, 1]
    rig.cycles(10)
    assert rig.heard.identity is not None
    found = rig.heard.identity.said
    assert found.serial is None
    assert found.model == rig.driver._settings.driver
    assert (found.mass, found.cog) == (0.7, (0.0, 0.01, 0.03))
    assert found.flange == pytest.approx(flange(core.motion.q)[:3].ravel(), abs=1e-9)


def test_collision_thresholds_are_set_at_the_start(rig: Rig) -> None:
    torque, force = OPTIONS["collision_torque"], OPTIONS["collision_force"]
    assert rig.arm.collision == (torque, torque, force, force)


def test_a_bad_connection_is_a_warning(rig: Rig) -> None:
    rig.started()
    rig.heard.notices.clear()
    rig.arm.rate = 0.9
    rig.cycles(900)
    assert not rig.heard.notices
    rig.cycles(150)
    assert rig.condition is Condition.ACTIVE
    assert any("10 %" in text for text in rig.heard.notices)


@pytest.mark.parametrize(
    ("options", "key"),
    [
        ({**OPTIONS, "collision_torque": [20.0] * 6}, "collision_torque"),
        ({**OPTIONS, "collision_force": [0.0] * 6}, "collision_force"),
        ({**OPTIONS, "success_rate": 2.0}, "success_rate"),
        ({**OPTIONS, "collision": 1.0}, "settings.collision:"),
        ({}, "collision_torque"),
    ],
)
def test_wrong_settings_are_refused(rig: Rig, options: dict[str, object], key: str) -> None:
    settings = DriverSettings("127.0.0.1", 40, (), (), 0.02, 6.0, rig.driver._settings.driver)
    with pytest.raises(RobotRefused, match=key):
        adapter_driver.made(
            DriverSettings(**{**settings.__dict__, "options": options}), socket.socket()
        )


PANDA_PYTHON = (
    "The robot speaks protocol version {}, but this panda-py was built with a "
    "libfranka that speaks version {}."
)
INCOMPATIBLE = (
    "libfranka: Incompatible library version (server version: {}, library version: {}). "
    "Please check https://frankarobotics.github.io for Panda support"
)


def test_the_wrong_library_is_refused_with_the_link_to_name() -> None:
    assert "link: panda" in refusal(INCOMPATIBLE.format(5, 10), "fr3")
    assert "link: fr3" in refusal(INCOMPATIBLE.format(10, 5), "panda")
    assert "link: fr3" in refusal("libfranka: incorrect object size", "panda")
    assert "link: fr3" in refusal(PANDA_PYTHON.format(10, 5), "panda")
    older = refusal(INCOMPATIBLE.format(7, 10), "fr3")
    assert older and "link: panda" not in older
    assert refusal("libfranka: Connection to FCI refused.", "fr3") == ""


def test_the_adapters_import_where_their_library_is(rig: Rig) -> None:
    name = rig.driver._settings.driver
    assert importlib.import_module(f"surg_hardware.franka.{name}_adapter").Driver.model == name
