"""Faults of an emulated UR arm: name -> what happens."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from surg_emulators.fault_lines import FaultError, Kind, choice, number, numbers, switch
from surg_emulators.ur.robot_states import SafetyMode
from surg_emulators.ur.rtde_server import DATA, packet

if TYPE_CHECKING:
    from surg_emulators.ur.ur_controller import UrController
    from surg_emulators.ur.ur_emulator import UrEmulator

SCRIPT_BYTES = 1 << 20


def kinds(emulator: UrEmulator) -> dict[str, Kind]:
    """The faults that only this arm has."""
    c = emulator.controller
    return {
        **_safety(c),
        **_people(c),
        **_settings(c),
        **_network(emulator),
    }


def _safety(c: UrController) -> dict[str, Kind]:
    def estop(which: str = "robot") -> None:
        modes = {
            "robot": SafetyMode.ROBOT_EMERGENCY_STOP,
            "system": SafetyMode.SYSTEM_EMERGENCY_STOP,
        }
        c.fall_to(choice(which, modes, "estop"), "button pressed")

    def unlock() -> str | None:
        return None if c.unlock() else "error: too early, 5 s must have passed"

    def release() -> None:
        c.release()

    return {
        "protective_stop": Kind(lambda: c.protective_stop("fault"), "", "as after a collision"),
        "unlock": Kind(unlock, "", "a person unlocks it on the pendant, 5 s later at the earliest"),
        "safeguard": Kind(lambda on="on": c.safeguard(switch(on)), "[on|off]", "safeguard stop"),
        "estop": Kind(estop, "[robot|system]", "emergency stop; cuts the power"),
        "release": Kind(release, "", "release the emergency stop, restart the safety system"),
        "violation": Kind(
            lambda: c.fall_to(SafetyMode.VIOLATION, "fault"), "", "a safety limit was broken"
        ),
        "fault": Kind(lambda: c.fall_to(SafetyMode.FAULT, "fault"), "", "the safety system fails"),
        "reduced": Kind(lambda on="on": c.reduce(switch(on)), "[on|off]", "reduced mode"),
    }


def _people(c: UrController) -> dict[str, Kind]:
    def power(on: str) -> None:
        c.power_on() if switch(on) else c.power_off()

    def brakes(how: str) -> None:
        choice(how, {"release": c.release_brakes, "engage": c.engage_brakes}, "brakes")()

    def slider(percent: str) -> None:
        c.slider = number(percent, "slider", 0.0, 100.0) / 100.0

    def limiter(percent: str) -> None:
        c.faked["speed_scaling"] = number(percent, "limiter", 0.0, 100.0) / 100.0

    def control(remote: bool) -> None:
        c.remote = remote

    def freedrive(on: str = "on", *qd: str) -> None:
        c.guide(switch(on), numbers(qd, 6, "freedrive", 3.0))

    def push(*force: str) -> None:
        c.wrench = [*numbers(force, 3, "push", 500.0), 0.0, 0.0, 0.0]

    def done(worked: bool) -> str | None:
        return None if worked else "error: not possible now"

    def load(path: str) -> None:
        file = Path(path)
        try:
            c.programs[file.name] = file.read_bytes()[:SCRIPT_BYTES].decode("utf-8", "replace")
        except OSError as error:
            raise FaultError(f"load: {path}: {error.strerror}") from error
        c.load(file.name)

    return {
        "power": Kind(power, "on|off", "power of the motors"),
        "brakes": Kind(brakes, "release|engage", "brakes of the joints"),
        "slider": Kind(slider, "PERCENT", "speed slider"),
        "limiter": Kind(limiter, "PERCENT", "states hold this speed scaling of the robot's own"),
        "local": Kind(lambda: control(False), "", "local control: scripts and orders are refused"),
        "remote": Kind(lambda: control(True), "", "remote control"),
        "freedrive": Kind(freedrive, "[on|off] [QD1 ... QD6]", "a hand guides the arm [rad/s]"),
        "push": Kind(push, "[FX FY FZ]", "something pushes at the tool, in base [N]"),
        "load": Kind(load, "FILE", "load a URScript file for play"),
        "play": Kind(lambda: done(c.play()), "", "a person presses play"),
        "pause": Kind(lambda: done(c.pause()), "", "a person presses pause"),
        "stop": Kind(c.stop, "", "a person presses stop"),
    }


def _settings(c: UrController) -> dict[str, Kind]:
    def payload(mass: str, *cog: str) -> None:
        place = numbers(cog, 3, "payload: centre", 1.0)
        c.set_payload(number(mass, "payload: mass", 0.0, 20.0), place)

    def tcp(*pose: str) -> None:
        c.tcp_offset = numbers(pose, 6, "tcp", math.tau)

    def serial(value: str) -> None:
        c.serial = value

    def second_client(*fields: str) -> None:
        for name in [name for name, owner in c.claims.items() if owner == "second client"]:
            del c.claims[name]
        c.claims.update(dict.fromkeys(fields, "second client"))

    return {
        "payload": Kind(payload, "MASS [X Y Z]", "payload that is set [kg, m]"),
        "tcp": Kind(tcp, "[X Y Z RX RY RZ]", "tool centre point that is set [m, rad]"),
        "serial": Kind(serial, "TEXT", "serial number"),
        "second_client": Kind(
            second_client, "[FIELD ...]", "another client holds these inputs (IN_USE); none: frees"
        ),
    }


def _network(emulator: UrEmulator) -> dict[str, Kind]:
    return {
        "reboot": Kind(emulator.reboot, "", "the controller starts again; RTDE starts twice"),
        "size0": Kind(lambda: emulator.send_raw(b"\x00\x00\x00"), "", "an RTDE packet with size 0"),
        "half": Kind(emulator.send_half, "", "half of an RTDE packet, then a reset"),
        "garbage": Kind(
            lambda: emulator.send_raw(packet(DATA, b"\x07" * 40)), "", "a state of no known recipe"
        ),
    }
