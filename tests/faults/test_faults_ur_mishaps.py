"""What changes on a UR while its arm moves: it rests, says why, and nothing moves again by itself.

Controller, link and emulated arm, exact in cycles; judged by the emulated arm's own joints.
``SURG_TEST_FULL=1`` draws 30 pairs of two mishaps.
"""

from __future__ import annotations

import math
import os
import random
from collections.abc import Callable

import numpy as np
import pytest

from helpers.hardware.emulated_chain import Chain, T
from surg_core import State
from surg_emulators.ur.robot_states import SafetyMode

pytestmark = pytest.mark.untimed

FULL = os.environ.get("SURG_TEST_FULL", "") not in ("", "0")
SPEED, STILL = 0.05, 5e-4
"""[m/s] Of the tip when it happens; a slower one is at rest."""
TO_REST, OFF, AGAIN = 0.25, 0.5, 5e-6
"""[s], [mm] Longest time to rest and largest deviation from the pivot; [m] nothing moves again."""


def local_pause(chain: Chain) -> None:
    chain.ur.dashboard = False
    chain.robot.pause()


def away(chain: Chain, lasting: int = 600) -> None:
    chain.ur.reboot(lasting)


def faked(name: str, value: float) -> Callable[[Chain], object]:
    return lambda chain: chain.robot.faked.update({name: value})


MISHAPS: dict[str, tuple[Callable[[Chain], object], str]] = {
    "payload": (lambda c: c.robot.set_payload(5.0, [0.0] * 3), "payload was changed on the robot"),
    "centre": (lambda c: c.robot.set_payload(0.0, [0.0, 0.0, 0.1]), "centre of gravity was"),
    "TCP": (
        lambda c: setattr(c.robot, "tcp_offset", [0, 0, 0.2, 0, 0, 0]),
        "tool centre point was",
    ),
    "not numbers": (faked("q", math.nan), "not numbers"),
    "paused in local control": (local_pause, "a program is paused"),
    "slider": (lambda c: setattr(c.robot, "slider", 0.5), "slider is at"),
    "limiter": (faked("speed_scaling", 0.4), "limits its speed to 40 %"),
    "protective stop": (lambda c: c.robot.protective_stop("test"), "protective stop"),
    "emergency stop": (
        lambda c: c.robot.fall_to(SafetyMode.ROBOT_EMERGENCY_STOP, "test"),
        "emergency stop",
    ),
    "reboot": (away, "does not answer"),
}
"""What happens, and words of the sentence."""


def moving(cycles: int = 300) -> Chain:
    chain = Chain()
    for cycle in range(cycles):
        assert chain.stream(SPEED * min(cycle / 60, 1.0)).state == State.ENABLED
    return chain


def stream(chain: Chain, cycles: int) -> tuple[np.ndarray, float, list[str]]:
    """Go on as if nothing had happened: tips (n, 3) [m], largest deviation [m], sentences."""
    tips, off, said = [chain.tip], 0.0, []
    for _ in range(cycles):
        chain.stream(SPEED)
        tips.append(chain.tip)
        off = max(off, chain.deviation)
        assert chain.status is not None
        said.append(chain.status.fault)
    return np.array(tips), off, said


@pytest.mark.parametrize("what", MISHAPS)
def test_a_mishap_in_motion_stops_the_arm_and_is_named(what: str) -> None:
    happen, sentence = MISHAPS[what]
    chain = moving()
    happen(chain)
    tips, off, said = stream(chain, 250)
    moved = np.linalg.norm(np.diff(tips, axis=0), axis=1) / T > STILL
    rest = T * (np.flatnonzero(moved)[-1] + 1)
    print(f"{what}: at rest after {1e3 * rest:.0f} ms, {1e3 * off:.3f} mm off the pivot")
    assert rest <= TO_REST
    assert 1e3 * off <= OFF
    assert any(sentence in each for each in said)
    assert chain.out.state != State.ENABLED


def mend(chain: Chain) -> None:
    """People put everything right; nobody starts the robot."""
    c = chain.robot
    chain.ur.dashboard = True
    c.faked.clear()
    c.slider = 1.0
    c.set_payload(0.0, [0.0] * 3)
    c.tcp_offset = [0.0] * 6
    c.release()
    c.unlock()
    c.release_brakes()
    c.play()


@pytest.mark.parametrize("seed", range(30 if FULL else 2))
def test_after_two_mishaps_at_once_nothing_moves_again_by_itself(seed: int) -> None:
    rng = random.Random(seed)
    first, second = rng.sample(sorted(MISHAPS), 2)
    chain = moving(rng.randrange(100, 300))
    MISHAPS[first][0](chain)
    stream(chain, rng.choice((0, 1, 5, 20)))
    MISHAPS[second][0](chain)
    stream(chain, 2600)  # a protective stop can be unlocked after 5 s
    rest = chain.tip
    mend(chain)
    tips, _, said = stream(chain, 1500)
    again = float(np.linalg.norm(tips - rest, axis=1).max())
    print(f"{first}, {second}: moved {1e6 * again:.1f} um, {said[-1]}")
    assert again < AGAIN
    assert not chain.link.active
