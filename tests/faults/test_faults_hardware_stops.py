"""Controller, link and emulated UR arm: whatever stops the arm, at which speed; exact in cycles.

Judged by the emulated arm's own joints. ``SURG_TEST_FULL=1`` runs every row at three speeds.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from helpers.hardware.emulated_cell import emulated_cell
from helpers.hardware.emulated_chain import Chain, T
from helpers.results.hardware_results import SPEEDS, note, note_stop, spread_row
from surg_core import State
from surg_emulators.ur.joint_motion import LAGS
from surg_emulators.ur.robot_states import SafetyMode
from surg_hardware.conditions import Condition

pytestmark = pytest.mark.untimed

FULL = os.environ.get("SURG_TEST_FULL", "") not in ("", "0")
TO_REST = {0.012: 120, 0.05: 120, 0.25: 200}
"""Tip speed -> longest time to rest [ms]."""
OURS, ITS_OWN = 0.2, 0.25
"""[mm] Largest deviation from the pivot at 12 and 50 mm/s: of a stop by the link or its program on
the robot, and of a stop by the robot. The emulated joints lag behind their targets by 5 to 8.5 ms,
each by its own (assumed). The controller holds the pivot with the joints. A robot that stops itself
ends at its targets; link and program end on the way of the joints."""
CREEP = 5e-4
"""[m/s] A slower tip is at rest."""


@dataclass(frozen=True)
class Fault:
    """What happens; ``lasting`` 0: until the end of the test [s]."""

    begin: Callable[[Chain], object]
    end: Callable[[Chain], object] = lambda chain: None
    lasting: float = 0.0
    off: float = ITS_OWN
    latched: bool = True


def stall(chain: Chain) -> None:
    chain.ur.silence = 0


def freeze(chain: Chain) -> None:
    chain.ur.silence, chain.ur.driver_runs = 0, False


def again(chain: Chain) -> None:
    chain.ur.silence, chain.ur.driver_runs = None, True


def silent(chain: Chain) -> None:
    chain.obeys_commands = False


def gone(chain: Chain) -> None:
    chain.obeys_commands = False
    chain.link.end("the link's node has ended")


def slider(chain: Chain) -> None:
    chain.robot.slider = 0.5


FAULTS = {
    "protective stop": Fault(lambda c: c.robot.protective_stop("test")),
    "emergency stop": Fault(lambda c: c.robot.fall_to(SafetyMode.ROBOT_EMERGENCY_STOP, "test")),
    "user stop": Fault(lambda c: c.robot.stop()),
    "user pause": Fault(lambda c: c.robot.pause()),
    "power off": Fault(lambda c: c.robot.power_off()),
    "reboot": Fault(lambda c: c.ur.reboot(600)),
    "slider at 50 %": Fault(slider, off=OURS),
    "stall 15 ms": Fault(stall, again, 0.015, OURS, latched=False),
    "stall 100 ms": Fault(stall, again, 0.1, OURS),
    "driver killed": Fault(freeze, off=OURS),
    "driver frozen 0.5 s": Fault(freeze, again, 0.5, OURS),
    "controller silent": Fault(silent, off=OURS),
    "node gone": Fault(gone, off=OURS),
}
SHORT = {("protective stop", 0.05), ("stall 100 ms", 0.05), ("controller silent", 0.05)}
"""What the normal tier runs."""
ROWS = [(what, speed) for what in FAULTS for speed in SPEEDS]


LAG_SPREADS = {(0.005, 0.0085): 0.25, (0.005, 0.007): 0.2, (0.0066, 0.0066): 0.03}
"""Least and largest lag of the joints [s] -> largest deviation [mm]."""


@pytest.mark.parametrize(("least", "largest"), LAG_SPREADS if FULL else [(0.005, 0.007)])
def test_where_a_robot_rests_that_stops_itself_is_set_by_how_its_joint_lags_differ(
    tmp_path: Path, least: float, largest: float
) -> None:
    """The shares of the lags between least and largest are those of the emulated UR5e.

    The cell states each joint's lag: two cycles until the target moves, and the joint's own.
    """
    shares = (np.array(LAGS) - min(LAGS)) / (max(LAGS) - min(LAGS))
    lags = [float(lag) for lag in least + shares * (largest - least)]
    stated = [2 * T + T / math.expm1(T / lag) for lag in lags]
    chain = Chain(lags=lags, cell=emulated_cell(tmp_path, "127.0.0.1", link_lag=stated))
    for cycle in range(300):
        chain.stream(0.05 * min(cycle / 60, 1.0))
    chain.robot.protective_stop("test")
    away = []
    for _ in range(150):
        chain.stream(0.05)
        away.append(chain.deviation)
    off = 1e3 * max(away)
    note(spread_row(1e3 * (largest - least)), 1, f"{off:.3f} mm")
    assert off <= LAG_SPREADS[least, largest]


@pytest.mark.parametrize(("what", "speed"), ROWS if FULL else sorted(SHORT))
def test_robot_condition_whatever_stops_the_arm_it_rests_near_its_pivot(
    what: str, speed: float
) -> None:
    fault, chain = FAULTS[what], Chain()
    for cycle in range(90 if speed > 0.1 else 300):  # the workspace ends 20 mm away
        assert chain.stream(speed * min(cycle / 60, 1.0)).state == State.ENABLED, chain.out.reason
    fault.begin(chain)
    tips, away = [chain.tip], [chain.deviation]
    for cycle in range(round((0.3 + fault.lasting) / T)):
        if cycle == round(fault.lasting / T):
            fault.end(chain)
        chain.stream(speed)
        tips.append(chain.tip)
        away.append(chain.deviation)
    speeds = np.linalg.norm(np.diff(tips, axis=0), axis=1) / T
    moving = np.flatnonzero(speeds > CREEP)
    rest = 1e3 * T * (moving[-1] + 1)
    off = 1e3 * max(away)
    assert off <= fault.off or speed > 0.1
    note_stop(what, speed, rest if fault.latched else None, off)
    if not fault.latched:
        assert chain.out.state == State.ENABLED
        return
    assert rest <= TO_REST[speed]
    assert chain.out.state != State.ENABLED
    assert chain.status is not None and chain.status.condition is not Condition.ACTIVE
    assert not chain.link.active or what == "driver killed"
