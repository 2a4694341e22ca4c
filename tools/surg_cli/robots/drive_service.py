"""What a person does to an instrument's drive by `./surg robot CELL drive`.

Nothing turns before that person has typed yes.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from surg_cli.graph import master, running
from surg_cli.graph.processes import wait_until
from surg_cli.host import cells
from surg_cli.host.terminal import CliError, Progress, confirm, say, table

if TYPE_CHECKING:
    from surg_hardware.drive.drive_file import DriveFile, Motor
    from surg_hardware.drive.drive_session import DriveSession

WORDS = {
    "find": "list every motor on the port, at any baud",
    "id": "give each motor id and baud of the drive's file, one after the other",
    "home": "turn a running drive against its stops",
    "test": "home, turn each joint a little, and measure; without a running system",
}
HOMED = ("HOMED", "RUNNING")
HOMING_S, ANSWER_S = 120.0, 15.0
"""[s] For a homing; for a node to be heard."""
TURN, TURN_S = 0.2, 1.0
"""[rad], [s] Of each joint in a test, there and back."""
WARNING = "The instrument turns. Is it out of the patient, and are all fingers away from it?"


def serve(word: str | None, folder: Path, cell: Any, arms: list[str], port: int | None) -> int:
    """Do one of `WORDS` for the drives of some arms; returns the exit code.

    Raises:
        CliError: There is no drive, its file must not be used, or it does not do it.
    """
    from surg_core import ConfigError
    from surg_hardware.drive.drive_file import drive_of
    from surg_hardware.drive.motor_values import DriveFailed

    if word is None:
        raise CliError(f"robot {folder.name} drive: one word is missing: {', '.join(WORDS)}", 2)
    if len(arms) > 1:
        arms = [arm for arm in cells.with_drive(cell) if arm in arms] or arms[:1]
    system = running.of_cell(folder, port)
    if (word == "home") != (system is not None):
        state, cure = ("is not running", "up") if system is None else ("has the port", "down")
        raise CliError(
            f"drive {word}: the system of {folder.name} {state}: ./surg {cure} {folder.name}"
        )
    for arm in arms:
        try:
            drive = drive_of(cell, arm)
            if system is not None:
                confirm(f"{arm}: {WARNING}")
                _home_running(system.master_uri, arm)
            else:
                {"find": _find, "id": _set_ids, "test": _test}[word](arm, drive)
        except ConfigError as error:
            raise CliError(str(error), 2) from error
        except DriveFailed as error:
            raise CliError(f"{arm}: {drive.name(error.motor or 0)}: {error.failure}") from error
        except OSError as error:
            cure = f"./surg robot {folder.name} doctor"
            raise CliError(f"{arm}: {drive.port}: {error}: {cure}") from error
    return 0


class DriveRequest:
    """Asks the running drive of an arm to home; rospy has been initialised."""

    def __init__(self, arm: str) -> None:
        import rospy

        from crtk_msgs.msg import StringStamped

        self.said = ""
        self._message = StringStamped(string="home")
        self._out = rospy.Publisher(f"/{arm}/tool/request", StringStamped, queue_size=1)
        self._ear = rospy.Subscriber(f"/{arm}/tool/status", StringStamped, self._hear)

    def _hear(self, message: Any) -> None:
        self.said = message.string

    @property
    def homed(self) -> bool:
        """Whether the drive says so."""
        return self.said.startswith(HOMED)

    def home(self) -> str:
        """Ask, and wait for the end; returns why not, or nothing."""
        if not wait_until(
            lambda: bool(self.said) and self._out.get_num_connections() > 0, ANSWER_S
        ):
            return "the drive's node says nothing: see ./surg status"
        before, self.said = self.said, ""
        self._out.publish(self._message)
        if not wait_until(lambda: bool(self.said), ANSWER_S):
            return f"{before}; it does not home: an arm that is ENABLED must be disabled first"
        with Progress("homing") as progress:
            begun = time.monotonic()

            def ended() -> bool:
                progress.update((time.monotonic() - begun) / HOMING_S, self.said)
                return not self.said.startswith(("HOMING", "IDENTIFIED"))

            wait_until(ended, HOMING_S)
        return "" if self.homed else self.said


def _home_running(uri: str, arm: str) -> None:
    with master.joined(uri, "surg_drive"):
        why = DriveRequest(arm).home()
    if why:
        raise CliError(f"{arm}: {why}")
    say(f"{arm}: homed")


def _find(arm: str, drive: DriveFile) -> None:
    from surg_hardware.drive.drive_checkup import scan

    rows = [[f"{baud} bit/s", drive.name(motor_id), model] for baud, motor_id, model in scan(drive)]
    say(f"{arm}: {drive.port}: {len(rows)} motors")
    say(table(rows))


def _set_ids(arm: str, drive: DriveFile) -> None:
    from surg_hardware.drive.drive_checkup import scan, set_id

    for motor in drive.motors:
        confirm(f"{arm}: connect only the motor of {motor.joint}; it gets the id {motor.id}.")
        there = list(scan(drive))
        if len(there) != 1 or there[0][2] != motor.model:
            found = ", ".join(f"{i} ({model}, {baud} bit/s)" for baud, i, model in there)
            raise CliError(
                f"{arm}: on the line are: {found or 'no motors'}; allowed: one {motor.model}"
            )
        set_id(drive, motor, there[0][0], there[0][1])
        say(f"{arm}: the motor of {motor.joint} is {motor.id} now, at {drive.baud} bit/s")


def _test(arm: str, drive: DriveFile) -> None:
    from surg_hardware.drive.drive_session import DriveSession

    confirm(f"{arm}: {WARNING}")
    session = DriveSession(drive)
    session.home()
    _turn(session, lambda: session.core.status.text.startswith("HOMING"), HOMING_S, {})
    _refuse_failed(arm, session)
    rows = []
    for motor in drive.motors:
        goal = min(TURN, motor.upper)
        for each in (goal, 0.0):
            off = _turn(session, lambda: True, TURN_S, {motor.joint: each})
            rows.append([motor.joint, f"to {each:g} rad", f"off by {off:.3f} rad"])
        _refuse_failed(arm, session)
    assert session.bus is not None
    rows.append(["answers", f"{session.bus.asked} asked", f"{session.bus.lost} lost"])
    session.bus.exchange({})  # every motor turns freely again
    session.close()
    say(table(rows))


def _turn(session: DriveSession, goes_on: Any, seconds: float, goal: dict[str, float]) -> float:
    """Cycle for some time [s]; returns how far the goal's joint is off it then [rad]."""
    from surg_hardware.drive.drive_session import PERIOD

    end = time.monotonic() + seconds
    while goes_on() and time.monotonic() < end:
        session.cycle(goal or None)
        time.sleep(PERIOD)
    status = session.core.status
    joints = dict(zip(session.joints, status.q, strict=False))
    return max((abs(joints.get(name, 0.0) - each) for name, each in goal.items()), default=0.0)


def _refuse_failed(arm: str, session: DriveSession) -> None:
    if not session.core.status.text.startswith(HOMED):
        session.close()
        raise CliError(f"{arm}: {session.core.status.text}")


def emulator_words(drive: DriveFile) -> list[str]:
    """The words that start a drive's emulator: its servos stand between their stops."""
    from surg_hardware.drive.drive_file import MODELS

    def servo(motor: Motor) -> str:
        homing, way = motor.homing, motor.sign * motor.gear
        far = homing.stop - homing.direction * homing.travel
        ends = sorted((way * homing.stop, way * far))
        made = {"servo_id": motor.id, "baud": drive.baud, "model": MODELS[motor.model].number}
        return json.dumps({**made, "stops": ends, "position": sum(ends) / 2})

    program = [sys.executable, "-s", "-m", "surg_emulators.drive.drive_emulator"]
    return [*program, str(drive.port), *map(servo, drive.motors)]
