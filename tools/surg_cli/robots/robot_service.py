"""What a person does to the arms of a cell by `./surg robot` while no link needs to run.

Power, brakes and unlocking are asked of a person first. Nothing here drives the arm.
"""

from __future__ import annotations

import datetime
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from surg_cli.host.terminal import CliError, confirm, say
from surg_hardware import identity
from surg_hardware.ur import primary, ur_service

_QUESTIONS = {
    "on": "powers the motors and releases the brakes. The arm can sag by some millimetres. Is "
    "everybody out of its reach, and the emergency stop in your hand?",
    "off": "cuts the motors' power: a moving arm stops hard. Shall it?",
    "recover": "unlocks the arm or restarts its safety system. Have you seen why it stopped?",
}


def serves(action: str, arm: Any) -> bool:
    """Whether an action is done here, without the link; a Franka's recovers by itself."""
    return action in ACTIONS and (action != "recover" or arm.link == "ur")


def serve(action: str, arm: Any, folder: Path) -> None:
    """Do one of `on`, `off`, `recover`, `kinematics` for one arm.

    Raises:
        CliError: The person says no, or the robot does not do it.
    """
    if arm.hardware is None or arm.link != "ur":
        raise CliError(
            f"{arm.name}: its link is {arm.link!r}; {action} is for 'ur'. Use the maker's own "
            "surface",
            2,
        )
    if action in _QUESTIONS:
        confirm(f"{arm.name} at {arm.hardware.address}: this {_QUESTIONS[action]}")
    try:
        if action == "kinematics":
            _kinematics(arm, folder)
        else:
            _ORDERS[action](arm.hardware.address, _teller(arm.name, folder))
    except ur_service.Refused as error:
        raise CliError(f"{arm.name}: {_named(str(error), folder)}") from error
    except OSError as error:
        raise CliError(
            f"{arm.name}: hardware.address {arm.hardware.address}: {error}: "
            f"./surg robot {folder.name} doctor"
        ) from error


_ORDERS: dict[str, Callable[[str, Callable[[str], None]], None]] = {
    "on": ur_service.power_on,
    "off": ur_service.power_off,
    "recover": ur_service.recover,
}
ACTIONS = {
    "on": "power the motors and release the brakes, after a question",
    "off": "cut the motors' power, after a question",
    "recover": "unlock a UR's protective stop, or restart its safety system, after a question; "
    "clear a Franka's reflex",
    "kinematics": "read the arm's own kinematics into the cell's calibration; moves nothing",
}


def _teller(arm: str, folder: Path) -> Callable[[str], None]:
    return lambda text: say(f"{arm}: {_named(text, folder)}")


def _named(text: str, folder: Path) -> str:
    return text.replace("robot CELL", f"robot {folder.name}")


def _kinematics(arm: Any, folder: Path) -> None:
    """Read, compare with the robot's own flange, and write.

    Raises:
        CliError: It is another arm, or its kinematics do not explain its flange pose.
        OSError: The arm does not answer.
    """
    import surg_core
    from surg_core import calibration

    address, path = arm.hardware.address, folder / "calibration" / f"kinematics_{arm.name}.yaml"
    there = ur_service.standstill(address)
    if there.serial != arm.hardware.serial:
        raise CliError(
            f"{arm.name}: hardware.serial: the cell says {arm.hardware.serial!r}, the robot is "
            f"{there.serial!r}: check address and serial; this is another arm",
            2,
        )
    found = primary.read_kinematics(address)
    text = calibration.kinematics_text(
        arm.robot.name, there.serial, datetime.date.today().isoformat(), vars(found)
    )
    drawn = surg_core.load_chain(arm.robot)
    try:
        own = surg_core.with_kinematics(drawn, surg_core.kinematics_of(text, str(path)))
    except ValueError as error:
        raise CliError(f"{path}: {error}: nothing was written", 2) from error
    before, after = (
        identity.flange_difference(chain.forward(there.q), there.X_BF) for chain in (drawn, own)
    )
    say(f"{arm.name}: the flange of the drawing is {_difference(before)} from the robot's own")
    if identity.flange_mismatch(own.forward(there.q), there.X_BF) is not None:
        raise CliError(
            f"{arm.name}: with the kinematics that the robot states it is {_difference(after)}; "
            f"allowed are {1e3 * identity.FLANGE_DISTANCE:g} mm and 0.1 deg: nothing was written. "
            "Restart the robot's controller, then call its maker"
        )
    calibration.write_kinematics(path, text)
    say(f"{arm.name}: with its own kinematics {_difference(after)}; written: {path}")
    say("Restart the system, and calibrate tool and trocar again.")


def _difference(of: tuple[float, float]) -> str:
    return f"{1e3 * of[0]:.3f} mm and {math.degrees(of[1]):.3f} deg"
