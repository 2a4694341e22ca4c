"""A UR driver on an emulated arm stops whatever happens, and stays stopped.

Real time, without ROS and without the controller: a motion through a trocar is played to the
driver. ``SURG_TEST_FULL=1`` runs every row at three speeds.
"""

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from helpers.hardware import emulated_ur
from helpers.hardware.ur_driver_rig import Record, Rig, Stop, plan, rig
from helpers.results.hardware_results import AGE, SPEEDS, note, note_stop
from surg_emulators.ur.joint_motion import DT
from surg_hardware.conditions import Condition

FULL = os.environ.get("SURG_TEST_FULL", "") not in ("", "0")
MOVING = 1.6
"""The fault comes this long after the start [s]."""
JUDGED = 1.0
"""The arm is watched for this long [s]."""
LATE = 0.05
"""Beside the tests' other load [s]."""
TO_REST = {0.012: 0.12, 0.05: 0.12, 0.25: 0.3}
"""Tip speed -> longest time to rest [s]. At the highest, the arm's own braking takes most of it."""
OFF = {0.012: 0.0002, 0.05: 0.0002, 0.25: 0.005}
"""Tip speed -> largest deviation from the pivot that the stop adds [m]."""


def frozen(arm: Rig) -> float:
    when = arm.kill(signal.SIGSTOP)
    time.sleep(0.5)
    arm.kill(signal.SIGCONT)
    return when


def silent(arm: Rig) -> float:
    arm.sending = False
    return time.monotonic()


def gone(arm: Rig) -> float:
    when = time.monotonic()
    arm.leave()
    return when


def played(arm: Rig) -> float:
    when = arm.fault("pause")
    time.sleep(0.5)
    assert "error" in emulated_ur.fault(arm.address, "play")  # the driver has ended the program
    return when


FAULTS = {
    "protective stop": lambda arm: arm.fault("protective_stop"),
    "emergency stop": lambda arm: arm.fault("estop"),
    "user stop": lambda arm: arm.fault("stop"),
    "user pause, then play": played,
    "slider at 50 %": lambda arm: arm.fault("slider 50"),
    "stall 15 ms": lambda arm: arm.fault("stall 0.015"),
    "stall 100 ms": lambda arm: arm.fault("stall 0.1"),
    "connections reset": lambda arm: arm.fault("reset"),
    "reboot": lambda arm: arm.fault("reboot"),
    "driver killed": lambda arm: arm.kill(signal.SIGKILL),
    "driver frozen": frozen,
    "controller silent": silent,
    "node gone": gone,
}
SHORT = {("driver killed", 0.05)}
"""What the normal tier runs."""
ROWS = [(what, speed) for what in FAULTS for speed in SPEEDS]


@pytest.mark.parametrize(
    ("what", "speed"), ROWS if FULL else sorted(SHORT), ids=lambda each: str(each)
)
def test_the_arm_comes_to_rest_and_stays_there(what: str, speed: float, tmp_path: Path) -> None:
    rows = plan(speed, MOVING + 2.0)
    with rig(tmp_path) as (arm, file):
        arm.start()
        arm.move(rows, MOVING)
        event = FAULTS[what](arm)
        time.sleep(max(0.0, event + JUDGED - time.monotonic()))
        if what not in ("driver killed", "node gone"):  # it latches
            assert (arm.condition() is Condition.ACTIVE) == (what == "stall 15 ms"), arm.notices
        end = time.monotonic()
    stop = Stop.after(Record.read(file), event, end)
    goes_on = what == "stall 15 ms"
    off = 1e3 * max(0.0, stop.off - stop.before)
    note_stop("processes", what, speed, None if goes_on else 1e3 * stop.to_rest, off)
    assert off <= 1e3 * OFF[speed]
    if goes_on:
        return
    assert stop.to_rest <= TO_REST[speed] + LATE
    assert stop.later < 1e-8  # rad


def test_a_command_is_executed_within_a_few_cycles(tmp_path: Path) -> None:
    with rig(tmp_path) as (arm, _):
        arm.start()
        arm.move(plan(0.012, 2.5), 2.0)
        ages = np.sort(arm.ages[-800:]) / DT
    middle, late = ages[len(ages) // 2], ages[int(0.99 * len(ages))]
    note(AGE, len(ages), f"median {middle:.1f} cycles, p99 {late:.1f}, max {ages[-1]:.1f}")
    assert len(ages) > 500
    assert middle <= 3.5  # with the way to the driver and back
