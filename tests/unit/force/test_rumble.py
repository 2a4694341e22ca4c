"""A gamepad rumbles with the force at the tip, and stops in time: on an exact clock."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from helpers.teleop.input_devices import GAMEPAD, Machine
from surg_teleop.leaders.bundled.gamepad import Gamepad
from surg_teleop.leaders.evdev.rumble import LEAST, Piece, Rumble

LIMIT_S = 0.050
CASES = 200


def felt_until(pieces: list[tuple[float, Piece]]) -> float:
    """When the motors rest [s]: a piece ends by itself, or with the next one."""
    end = -np.inf
    for at, piece in pieces:
        end = at + piece.seconds if piece.strength > 0 else min(end, at)
    return end


@pytest.mark.parametrize("ends_by", ["silence", "clutch or pause"])
def test_the_rumble_ends_in_fifty_milliseconds(ends_by: str) -> None:
    """Ticks of 20 to 500 Hz, forces of 50 to 500 Hz; the end at any phase."""
    rng, longest = np.random.default_rng(11), 0.0
    for _ in range(CASES):
        rumble, end = Rumble(5.0), rng.uniform(0.5, 0.6)
        forces = np.arange(0.0, end, rng.uniform(0.002, 0.020))
        events = [(float(t), True) for t in forces]
        last = events[-1][0]
        if ends_by != "silence":
            events += [(float(t), False) for t in np.arange(end, end + 0.2, 0.005)]
            last = end
        ticks = np.arange(rng.uniform(0, 0.01), end + 0.2, 1.0 / rng.uniform(20.0, 500.0))
        pieces = []
        for now in ticks:
            while events and events[0][0] <= now:
                at, allowed = events.pop(0)
                rumble.take(3.0, allowed, at)
            if (piece := rumble.step(float(now))) is not None:
                pieces.append((float(now), piece))
        assert pieces and {piece.strength for _, piece in pieces} <= {0.6, 0.0}
        longest = max(longest, felt_until(pieces) - last)
    print(f"{ends_by}: {CASES} cases, the motors rest after {1e3 * longest:.1f} ms")
    assert longest <= LIMIT_S


def test_the_strength_is_the_forces_share_and_bounded() -> None:
    rumble = Rumble(4.0)
    for i, (force, strength) in enumerate(((2.0, 0.5), (40.0, 1.0), (4.0 * LEAST, LEAST))):
        rumble.take(force, True, float(i))
        piece = rumble.step(float(i))
        assert piece is not None and piece.strength == pytest.approx(strength)
    for i, force in enumerate((4.0 * LEAST - 1e-3, float("nan"), float("inf")), 10):
        rumble.take(force, True, float(i))
        piece = rumble.step(float(i))
        assert piece in (None, Piece(0.0, 0.0))


def test_it_does_not_gap_while_forces_come() -> None:
    rumble, ends = Rumble(5.0), []
    for k in range(500):
        now = 0.002 * k
        rumble.take(3.0, True, now)
        if (piece := rumble.step(now)) is not None:
            ends.append((now, now + piece.seconds))
    assert all(end > begin for (_, end), (begin, _) in pairwise(ends))


def test_the_leaders_device_plays_it() -> None:
    machine = Machine()
    pad = machine.plug(GAMEPAD)
    leader = Gamepad(host=machine)
    leader.rumble(Piece(1.0, 0.04))  # not open: nothing
    leader.open()
    assert leader.rumbles
    leader.rumble(Piece(0.5, 0.04))
    assert pad.motors.played == [(0.5, 0.04)]
    leader.close()
    assert not leader.rumbles
