"""The UR link and its program on the emulated arm, exact in cycles: what ends a motion.

With the controller: `tests/faults/test_faults_hardware.py` and `test_faults_hardware_stops.py`.
"""

import numpy as np
import pytest

from helpers.hardware.ur_chain import STOP, Chain
from surg_emulators.ur.joint_motion import DT
from surg_emulators.ur.ur_controller import UNLOCK_AFTER
from surg_hardware.conditions import Condition

QD = (0.1, -0.05, 0.08, 0.02, -0.1, 0.05)


def moving(qd: tuple[float, ...] = QD, cycles: int = 150) -> Chain:
    """A chain whose arm moves."""
    chain = Chain()
    chain.cycles(5)
    chain.start()
    chain.cycles(cycles, qd)
    assert chain.condition is Condition.ACTIVE
    assert chain.controller.motion.actual_qd == pytest.approx(qd, abs=1e-3)
    return chain


def protective(chain: Chain) -> None:
    chain.controller.protective_stop("test")


def safeguard(chain: Chain) -> None:
    chain.controller.safeguard(True)


def pause(chain: Chain) -> None:
    assert chain.controller.pause()


def unlock(chain: Chain) -> None:
    chain.cycles(round(UNLOCK_AFTER / DT))
    assert chain.controller.unlock()


def close_safeguard(chain: Chain) -> None:
    chain.controller.safeguard(False)


MENDED = {protective: unlock, safeguard: close_safeguard, pause: lambda chain: None}
"""What ends a motion -> how people mend it."""


def test_a_command_is_executed_after_two_cycles_and_its_stamp_comes_back() -> None:
    chain = moving(cycles=300)
    ages = []
    for _ in range(100):
        chain.cycle(QD)
        assert chain.status is not None
        ages.append(chain.now - 1e-9 * chain.status.last_command_ns)
    assert max(ages) == pytest.approx(2 * DT)
    target = list(chain.controller.motion.qd)
    count = 0
    while chain.controller.motion.qd == pytest.approx(target):
        chain.cycle(tuple(2.0 * rate for rate in QD))
        count += 1
    print(f"echo after {max(ages) / DT:.0f} cycles, motion after {count - 1}")
    assert count - 1 == 2


@pytest.mark.parametrize("fault", MENDED, ids=lambda each: each.__name__)
@pytest.mark.parametrize("control", ["remote", "local"])
def test_play_on_the_pendant_moves_nothing_after_a_stop_or_a_pause(fault, control) -> None:  # type: ignore[no-untyped-def]
    """A person presses play: a program that is still there would go on with its old speed.

    In local control the robot refuses to end the program: its watchdog ends it as it wakes.
    """
    chain = moving()
    chain.dashboard = control == "remote"
    fault(chain)
    chain.cycles(300, QD)
    assert chain.controller.motion.at_rest
    rest = list(chain.controller.motion.actual_q)
    MENDED[fault](chain)
    played = chain.controller.play()
    chain.cycles(500, QD)
    moved = max(abs(b - a) for a, b in zip(rest, chain.controller.motion.actual_q, strict=True))
    print(f"{fault.__name__}, {control}: played {played}, moved {moved:.1e} rad")
    assert played == (control == "local")
    assert moved < (1e-9 if control == "remote" else 3e-6)
    assert chain.controller.motion.at_rest
    assert chain.condition is Condition.READY


def test_a_silent_driver_ends_the_motion_by_the_robots_own_dead_man() -> None:
    chain = moving()
    cycles = 0
    while not chain.controller.motion.at_rest:
        chain.controller.advance()
        chain.controller.execute()
        cycles += 1
        assert cycles < 500, "it goes on for ever"
    assert 10 <= cycles <= 45
    assert chain.controller.program is None


def test_the_program_stops_the_arm_on_the_way_of_its_joints() -> None:
    """The joints lag by 5 to 8.5 ms; targets that merely stop would take them off their way."""
    for qd in (QD, (0.9, -0.5, 1.0, 0.3, -0.8, 0.6), (0.002, 0.0, -0.001, 0.0, 0.0, 0.001)):
        chain = moving(qd)
        motion = chain.controller.motion
        way = np.array(qd) / np.linalg.norm(qd)
        start, ahead = np.array(motion.actual_q), np.subtract(motion.q, motion.actual_q)
        chain.silence, chain.driver_runs = 0, False
        speeds = []
        for _ in range(100):
            chain.cycle()
            speeds.append(list(motion.qd))
        end = np.array(motion.actual_q) - start
        off = np.linalg.norm(end - (end @ way) * way)
        beside = np.linalg.norm(ahead - (ahead @ way) * way)
        braking = np.abs(np.diff(speeds, axis=0)).max() / DT
        print(f"{off:.1e} of {beside:.1e} rad, {braking:.1f} rad/s^2")
        assert motion.at_rest and chain.controller.program is None
        assert off < 0.02 * beside
        assert braking <= 1.6 * STOP
