"""What a person may ask of a UR link, and when; whom its driver refuses. On the emulated arm."""

from __future__ import annotations

import contextlib
import json
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from helpers.hardware import emulated_ur
from helpers.hardware.ur_driver_rig import DriverThread, Rig, driver, rig, settings_of
from surg_cli.graph.processes import wait_until
from surg_emulators.ur import rtde_server, ur_controller
from surg_emulators.ur.ur_controller import HOME, UrController
from surg_hardware import robot_link
from surg_hardware.conditions import Condition
from surg_hardware.ur import dashboard, ur_driver

OTHER = "def other():\n  while True:\n    sync()\n  end\nend\n"


@pytest.fixture
def arm(tmp_path: Path) -> Iterator[Rig]:
    """A driver and its arm; the commands are zero."""
    with rig(tmp_path) as made:
        made.wait(Condition.READY)
        yield made


def ask(arm: Rig, word: str, enabled: bool = False) -> str:
    """The driver's refusal; empty: it has said none within 0.5 s."""
    arm.notices.clear()
    arm.request(word, enabled)
    wait_until(lambda: bool(arm.notices), 0.5)
    return arm.notices[0] if arm.notices else ""


def said(arm: Rig) -> dict[str, object]:
    """The emulated controller's own state."""
    found: dict[str, object] = json.loads(emulated_ur.fault(arm.address, "status"))
    return found


def test_a_hand_guides_the_arm_only_while_the_controller_is_disabled(arm: Rig) -> None:
    assert "DISABLED" in ask(arm, "guide", enabled=True)
    assert said(arm)["runtime"] == "STOPPED"
    assert ask(arm, "guide") == ""
    arm.wait(Condition.GUIDED)
    arm.fault("freedrive on 0.2 0 0 0 0 0")
    assert wait_until(lambda: arm.state is not None and arm.state.q[:1] > (HOME[0] + 0.02,), 3.0), (
        "the joint states go on, so that poses can be collected"
    )
    arm.fault("freedrive on")
    assert "hand guiding" in ask(arm, "start"), "an arm in a hand is not started"
    assert ask(arm, "stop") == ""
    arm.wait(Condition.READY)
    before = said(arm)["q"]
    time.sleep(0.2)
    assert said(arm)["q"] == pytest.approx(before, abs=1e-9)
    # The register in which the ended program said that a hand guides the arm still says so.
    assert wait_until(lambda: ask(arm, "start") == "", 5.0)
    arm.wait(Condition.ACTIVE)


def test_a_start_is_refused_with_its_cure(arm: Rig, tmp_path: Path) -> None:
    program = tmp_path / "other.script"
    program.write_text(OTHER)
    arm.fault(f"load {program}")
    arm.fault("play")
    assert wait_until(lambda: "a program runs" in ask(arm, "start"), 5.0)
    arm.fault("stop")
    arm.fault("brakes engage")
    arm.wait(Condition.BRAKED)
    assert "brakes" in ask(arm, "start")
    arm.fault("brakes release")
    arm.wait(Condition.READY)
    arm.fault("local")
    assert wait_until(lambda: "local control" in ask(arm, "start"), 5.0)
    assert "allowed: " in ask(arm, "dance")
    assert arm.condition() is Condition.READY
    assert said(arm)["q"] == pytest.approx(list(HOME), abs=1e-9), "nothing has moved"


def test_a_payload_that_is_set_while_the_link_drives_ends_it_by_name(arm: Rig) -> None:
    arm.start()
    arm.fault("payload 5 0 0 0.1")
    arm.wait(Condition.READY, 60.0)
    assert arm.state is not None and "from 0 to 5 kg" in arm.state.status.fault


def test_after_a_reset_the_status_says_who_holds_the_registers(arm: Rig) -> None:
    arm.fault("second_client input_int_register_24")
    arm.fault("reset")
    said = wait_until(lambda: arm.state is not None and "IN_USE" in arm.state.status.fault, 60.0)
    assert said, arm.state
    assert arm.condition() is Condition.OFFLINE and "end it" in arm.state.status.fault  # type: ignore[union-attr]
    arm.fault("second_client")
    arm.wait(Condition.READY, 60.0)


def test_states_go_on_while_the_dashboard_takes_its_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked, go_on, ask = threading.Event(), threading.Event(), dashboard.ask

    def late(address: str, questions: tuple[str, ...], timeout: float = 10.0) -> list[str]:
        if questions == ("is in remote control",):
            asked.set()
            assert go_on.wait(60.0)
        return ask(address, questions, timeout)

    monkeypatch.setattr(dashboard, "ask", late)
    monkeypatch.setattr(robot_link, "SETTLED", 0.1)
    with emulated_ur.in_process(UrController()) as emulator:
        made = DriverThread(emulator.address)
        made.until(lambda _: asked.is_set(), "start")
        states = iter(range(200))
        made.until(lambda found: found is Condition.READY and next(states, None) is None)
        go_on.set()
        made.until(lambda condition: condition is Condition.ACTIVE)
        made.end()


def refused(address: str, **env: str) -> str:
    """Why a driver that is started now ends with exit code 2."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, driver(address, theirs, subprocess.PIPE, **env) as second:
        _, said = second.communicate(timeout=20.0)
    assert second.returncode == 2, said
    return said


def test_two_controllers_do_not_drive_one_robot(arm: Rig, tmp_path: Path) -> None:
    """The first goes on; the second is refused here by a lock, elsewhere by the robot's inputs."""
    arm.start()
    assert "another driver" in refused(arm.address)
    elsewhere = refused(arm.address, TMPDIR=str(tmp_path))  # its lock lies there
    assert "input_int_register_24" in elsewhere and "IN_USE" in elsewhere
    assert arm.state is not None
    busy_machine = "stood still" in arm.state.status.fault
    assert arm.condition() is Condition.ACTIVE or busy_machine, arm.state.status


@pytest.mark.untimed
def test_a_field_that_the_robot_does_not_know_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    known = {name: kind for name, kind in rtde_server.OUTPUTS.items() if name != "payload_cog"}
    monkeypatch.setattr(rtde_server, "OUTPUTS", known)
    with emulated_ur.in_process(UrController()) as emulator:
        said = refused(emulator.address)
    assert "payload_cog" in said and "NOT_FOUND" in said


@pytest.mark.untimed
def test_an_old_controller_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ur_controller.VERSIONS, "5", (5, 5, 1, 82186))
    with emulated_ur.in_process(UrController()) as emulator:
        said = refused(emulator.address)
    assert "5.5.1.82186" in said and "PolyScope 5.6" in said


@pytest.mark.untimed
@pytest.mark.parametrize(
    ("answers", "said"), [(b"", "refused"), (b"SSH-2.0\n", "something else than a UR")]
)
def test_an_address_where_no_ur_answers_is_refused(
    answers: bytes, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What ends a driver with exit code 2 here, too."""
    monkeypatch.setattr(ur_driver, "FIRST_CONNECTION", 0.1)
    address = emulated_ur.free_address()
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs, contextlib.ExitStack() as peers:
        if answers:
            server = socket.create_server((address, dashboard.DASHBOARD_PORT))
            peers.enter_context(server)
            threading.Thread(target=greet, args=(server, answers), daemon=True).start()
            peers.callback(server.shutdown, socket.SHUT_RDWR)
        made = ur_driver.UrDriver(settings_of(address), theirs)
        with pytest.raises(TimeoutError, match=rf"hardware\.address: .*{said}"):
            made.run()


def greet(server: socket.socket, words: bytes) -> None:
    """Say the same to everybody."""
    with contextlib.suppress(OSError):
        while True:
            peer, _ = server.accept()
            with peer:
                peer.sendall(words)
