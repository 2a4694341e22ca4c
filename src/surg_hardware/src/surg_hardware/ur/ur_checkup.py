"""The check-up of a UR arm: asks its controller and listens to RTDE; moves nothing."""

from __future__ import annotations

import select
import time
from typing import TYPE_CHECKING

from surg_hardware import checkup, identity
from surg_hardware.checkup import Finding
from surg_hardware.conditions import Condition
from surg_hardware.driver_process import finite, is_emulated
from surg_hardware.ur import orders
from surg_hardware.ur.controller_version import round_trips
from surg_hardware.ur.rtde import Rtde, RtdeRefused, Values
from surg_hardware.ur.ur_states import arm_identity, robot_state

if TYPE_CHECKING:
    import surg_core

CONNECTION = "check power, cable and address; PolyScope 5 or X is needed"


def examine(arm: surg_core.Arm, seconds: float) -> list[Finding]:
    """All findings about the arm at the cell's address.

    Args:
        arm: Of the cell, with hardware.
        seconds: How long its states and its answers are measured [s].
    """
    hardware = arm.hardware
    assert hardware is not None
    address = hardware.address
    try:
        robot = orders.of(address)
        version, remote, running = robot.version(), robot.remote(), robot.running()
        serial, model = robot.identity()
    except RtdeRefused as error:
        return [Finding("version", error.sentence, False, error.cure)]
    except OSError as error:
        return [Finding("hardware.address", f"{address}: {error}", False, CONNECTION)]
    found = [
        Finding("hardware.address", f"a UR controller answers at {address}"),
        Finding("version", version),
        _remote(remote),
        _program(running),
    ]
    try:
        rtde, line = _connected(address)
        found.append(line)
        try:
            values, exchange = _listen(rtde, seconds / 2)
        finally:
            rtde.close()
        trips = round_trips(address, seconds / 2)
    except OSError as error:
        return [*found, Finding("RTDE", str(error), False, CONNECTION)]
    found += [_condition(values), _speed(values)]
    if not finite(values["actual_q"]):
        return [*found, Finding("joints", "are not numbers", False, "restart the robot")]
    found += identity.findings(arm, values["actual_q"], arm_identity(values, serial, model))
    found += checkup.exchange_findings(exchange, is_emulated(address))
    found.append(checkup.round_trip_finding(trips))
    return found


def _remote(remote: bool) -> Finding:
    return Finding(
        "control",
        "remote" if remote else "local: the robot takes no programs from this machine",
        remote,
        "" if remote else "switch it to remote control on the pendant",
    )


def _program(runs: bool) -> Finding:
    return Finding(
        "program",
        "a program runs on the robot" if runs else "none runs",
        not runs,
        "stop it: on the pendant, or ./surg robot CELL stop if it is ours" if runs else "",
    )


def _connected(address: str) -> tuple[Rtde, Finding]:
    """A connection, which cannot command where another client does, and its line."""
    try:
        return Rtde(address), Finding("RTDE", "all fields are there, no other client commands")
    except RtdeRefused as error:
        text = error.sentence.removeprefix("RTDE: ")
        return Rtde(address, inputs=False), Finding("RTDE", text, False, error.cure)


def _listen(rtde: Rtde, seconds: float) -> tuple[Values, checkup.Exchange]:
    """The newest state, and how states arrive.

    Raises:
        TimeoutError: Fewer than three have come within this time and a second.
    """
    stamps: list[float] = []
    arrivals: list[float] = []
    newest: Values = {}
    started = time.monotonic()
    while (now := time.monotonic()) < started + seconds or len(stamps) < 3:
        if now > started + seconds + 1.0:
            raise TimeoutError(f"{len(stamps)} states within {now - started:.1f} s")
        select.select((rtde,), (), (), 0.1)
        values = rtde.newest()
        if values is not None:
            newest = values
            stamps.append(values["timestamp"][0])
            arrivals.append(time.monotonic())
    return newest, checkup.Exchange.of(stamps, arrivals)


def _condition(values: Values) -> Finding:
    """Power, brakes, safety, slider: what the robot would say to `start`."""
    reading = robot_state(values).reading
    good = reading.condition is Condition.READY
    text = reading.sentence or "powered, brakes released, no stop, speed slider at 100 %"
    return Finding("condition", text, None if good and reading.sentence else good, reading.cure)


def _speed(values: Values) -> Finding:
    slider, limiter = values["target_speed_fraction"][0], values["speed_scaling"][0]
    text = f"slider at {100 * slider:.0f} %, the robot's own limiter at {100 * limiter:.0f} %"
    return Finding("speed", text, None)
