"""Steers a tip to places by small motions of a hand: which motion does what is found by trying."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable

import numpy as np

from helpers.teleop.chromium import until
from helpers.teleop.phantom import Phantom

NEAR = 0.002
"""[m] from the tip to a target that counts as touched."""
LONGEST = 0.06
"""[m] of the hand at once."""
WITHIN_S = 90.0
REST_S = 0.4
"""[s] that a tip must stand, to be at rest: a busy machine lets it come late."""

Move = Callable[[np.ndarray], Awaitable[None]]
"""Moves the hand by (3,) [m] in its own axes, and returns when the tip has come to rest."""


async def rest(made: Phantom) -> None:
    """Wait until the tip has stood for a while, by what it says itself."""
    called = time.monotonic()

    async def stands() -> bool:
        if not made.tips:  # an arm that is not enabled yet has no place
            return False
        return made.tips[-1][0] - max(called, made.rest_since()) > REST_S

    await until(stands, "a tip at rest", 60.0)


async def probe(made: Phantom, move: Move, by: float = 0.03) -> np.ndarray:
    """(3, 3) of the tip's motion in its rcm frame by the hand's; there and back along each axis."""
    await move(np.zeros(3))
    columns = []
    for axis in np.eye(3):
        ways = []
        for sign in (1.0, -1.0):
            for _ in range(8):  # a busy machine may let go in between
                before = made.tip
                await move(sign * by * axis)
                way = sign * (made.tip - before) / by
                if np.linalg.norm(way) > 0.1:
                    break
            ways.append(way)
        columns.append(np.mean(ways, axis=0))
    return np.array(columns).T


async def touch(made: Phantom, move: Move, J: np.ndarray, target: np.ndarray) -> float:
    """Move until the tip is at a target (3,) in its rcm frame [m]; how long it took [s]."""
    began, inverse = time.monotonic(), np.linalg.inv(J)
    while np.linalg.norm(target - made.tip) > NEAR:
        assert time.monotonic() - began < WITHIN_S, (target, made.tip)
        step = inverse @ (target - made.tip)
        await move(step * min(1.0, LONGEST / float(np.linalg.norm(step))))
    return time.monotonic() - began


def one_hand_frame(J: np.ndarray) -> None:
    """The hand's axes are at right angles, of one length and right-handed at the tip.

    Raises:
        AssertionError: They are not.
    """
    lengths = np.linalg.norm(J, axis=0)
    assert lengths.min() > 0.6 * lengths.max(), lengths
    unit = J / lengths
    assert np.abs(unit.T @ unit - np.eye(3)).max() < 0.2, unit
    assert np.linalg.det(unit) > 0.9, "x right, y down, z away are right-handed"
