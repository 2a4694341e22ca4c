"""Bumps of 0.5 to 20 mm and 0.5 to 10 degrees, and what a watch says of one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from helpers.perception.drift_bench import (
    SCOPE,
    TOOL,
    Array,
    DriftBench,
    Motion,
    Moved,
    beside,
    look_without_pictures,
)
from helpers.perception.drift_settings import Flaws, Setting
from surg_perception.drift.drift_evidence import NEWEST
from surg_perception.drift.drift_state import MOVED, UNKNOWN, DriftState, state_of
from surg_perception.drift.drift_watch import SHAFT, DriftWatch
from surg_perception.drift.moving_parts import BASE, CAMERA, LAG, LENS
from surg_perception.drift.moving_parts import TOOL as INSTRUMENT

RATE = 9.0
"""Pictures a second: no pair comes sooner after another than the watch looks."""
SINCE, SECONDS = 12.0, 32.0
"""When a part moves, and when the motion ends [s]."""
SOON = 10.0
"""[s] Within which a bump is to be found."""
PIXELS, SECOND = 5.4, 0.05
"""[px], [s] A lens or a lag that moves so much counts as 1 mm, as a shaft 85 mm away is shown."""
SHOWN = 2.0
"""[px] Bumps that shift by less what is seen, while it is seen, hardly show."""


@dataclass(frozen=True)
class Bump:
    """Which part moved, and by how much [mm], [deg]."""

    kind: str
    size: float
    turn: float
    moved: Moved

    def beyond(self, size: float, turn: float) -> bool:
        """Whether it is at least so large."""
        return self.size >= size or self.turn >= turn


def drawn(rng: np.random.Generator, n: int = 3) -> Array:
    """A unit vector (n,)."""
    way = rng.normal(size=n)
    return np.asarray(way / np.linalg.norm(way))


def any_bump(rng: np.random.Generator) -> Bump:
    """Of any part: shifted, turned or both; small and large sizes are as frequent."""
    kind = (CAMERA, BASE, LENS, INSTRUMENT, LAG)[int(rng.integers(5))]
    size = float(np.exp(rng.uniform(np.log(0.5), np.log(20.0))))
    turn = float(np.exp(rng.uniform(np.log(0.5), np.log(10.0))))
    which = int(rng.integers(3))
    turn *= kind not in (LENS, LAG) and which > 0
    size *= kind in (LENS, LAG) or which != 1
    step = np.r_[np.radians(turn) * drawn(rng), 0.001 * size * drawn(rng)]
    eye, arm, way = int(rng.integers(2)), (SCOPE, TOOL)[int(rng.integers(2))], drawn(rng, 2)
    made: dict[str, Callable[[], Moved]] = {
        CAMERA: lambda: Moved(camera=step),
        BASE: lambda: Moved(base={arm: step}),
        LENS: lambda: Moved(lens={eye: PIXELS * size * way}),
        INSTRUMENT: lambda: Moved(tool=step),
        LAG: lambda: Moved(lag=min(SECOND * size, 0.15)),
    }
    return Bump(kind, size, turn, made[kind]())


@dataclass
class Said:
    """What a watch says while a bump happens.

    Attributes:
        found: How long after the bump [s]; None: not within `SOON`.
        early: Whether it said so before.
        sightings: How many there were within `SOON`.
        shift: Root mean square of what the bump shifts in those [px].
        last: The last state.
        held: Of each judgement after the bump: whether the interval holds the truth.
    """

    found: float | None = None
    early: bool = False
    sightings: int = 0
    shift: float = 0.0
    last: DriftState | None = None
    held: list[bool] = field(default_factory=list)

    @property
    def shown(self) -> bool:
        """Whether there was something to find."""
        return self.sightings >= NEWEST and self.shift >= SHOWN


def watched(bench: DriftBench, watch: DriftWatch, setting: Setting, bump: Moved, seed: int) -> Said:
    """What the watch says of a bump after `SINCE`."""
    rng = np.random.default_rng([seed, 1])
    flaws, motion = Flaws(setting, rng), Motion(bench.chain, seed, SECONDS, True, RATE)
    said, truth, shifts, judged = Said(), list[float](), list[float](), None
    for at in map(float, motion.t):
        moved = flawed(bump if at >= SINCE else Moved(), flaws, at)
        if not look_without_pictures(watch, bench, motion, at, moved, rng, flaws):
            continue
        truth.append(0.0 if at < SINCE else true_way(bench, watch, motion, at, moved))
        said.last = state = state_of(watch.verdict, watch.unseen)
        if at < SINCE:
            said.early |= state.word == MOVED
            continue
        soon = at < SINCE + SOON
        said.sightings += soon
        if soon:
            eyes = [eye for eye in (0, 1) if not flaws.hidden(at, eye)]
            shifts.append(_shift(bench, motion, at, bump, eyes))
        if state.word == MOVED and said.found is None and soon:
            said.found = at - SINCE
        if watch.verdict is not judged and state.word != UNKNOWN and all(truth[-NEWEST:]):
            rms = float(np.sqrt(np.mean(np.square(truth[-NEWEST:]))))
            said.held.append(state.beside[0] <= rms <= state.beside[2])
        judged = watch.verdict
    said.shift = float(np.sqrt(np.mean(np.square(shifts)))) if shifts else 0.0
    return said


def flawed(moved: Moved, flaws: Flaws, at: float) -> Moved:
    """With the instrument as it is mounted and bent."""
    return replace(moved, tool=moved.tool + flaws.tool_at(at))


def true_way(
    bench: DriftBench, watch: DriftWatch, motion: Motion, at: float, moved: Moved
) -> float:
    """How far the shaft's end is seen beside its place by joints, across the shaft [m]."""
    true = bench.shaft(motion, at, moved, np.array([SHAFT[0]]))[0]
    true[:2] += moved.lens.get(0, np.zeros(2)) * true[2] / bench.focal
    p_V = watch._newest[TOOL].p_V
    along = (p_V[-1] - p_V[0]) / np.linalg.norm(p_V[-1] - p_V[0])
    return float(np.linalg.norm(np.cross(true - p_V[0], along)))


def _shift(bench: DriftBench, motion: Motion, at: float, bump: Moved, eyes: list[int]) -> float:
    """How far a bump shifts the shaft across itself in the pictures [px], at most of these eyes."""
    up = np.linspace(0.005, 0.1, 30)
    before, after = (bench.shaft(motion, at, each, up) for each in (Moved(), bump))
    ways = [
        beside(bench.pixels(before, eye, Moved()), bench.pixels(after, eye, bump), [6, 20])[1]
        for eye in eyes
    ]
    return float(np.sqrt(np.mean(np.square(ways), axis=1)).max())
