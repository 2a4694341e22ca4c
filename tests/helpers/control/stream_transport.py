"""What a stream meets between hand and filter, and how well it is followed then."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from helpers.control.hand_motions import Array, Hand
from helpers.control.stream_laws import PATH_CUTOFF_HZ, TICK, violations
from surg_core import _core
from surg_recording import metrics

SETTLED = 2.0
"""[s] from the start that are not judged: clock and estimate settle."""
CLOCK = (1234.5, 1 + 5e-5)
"""Offset [s] and rate of the sender's clock."""


@dataclass(frozen=True)
class Transport:
    """How samples reach the receiver.

    Attributes:
        burst: Messages are delivered together, every so many seconds; 0: at once.
        jitter: Each message is delayed by up to so many seconds; none overtakes another.
        stamped: Whether the messages carry the sender's stamps.
    """

    burst: float = 0.0
    jitter: float = 0.0
    stamped: bool = True

    def arrivals(self, taken: Array, seed: int = 0) -> Array:
        """When the samples arrive (n,) [s]."""
        rng = np.random.default_rng(seed)
        if self.burst > 0:
            phase = rng.uniform(0, self.burst)
            return np.ceil((taken - phase) / self.burst - 1e-9) * self.burst + phase
        late = rng.uniform(0, self.jitter, size=len(taken)) if self.jitter > 0 else 0.0
        return np.maximum.accumulate(taken + late)

    def __str__(self) -> str:
        kind = (
            f"bursts of {1e3 * self.burst:g} ms"
            if self.burst > 0
            else f"jitter {1e3 * self.jitter:g} ms"
            if self.jitter > 0
            else "regular"
        )
        return kind if self.stamped else f"{kind}, no stamps"


@dataclass(frozen=True)
class Option:
    """Delay [s] and tremor [Hz] of the robot's file."""

    delay: float = 0.0
    tremor: float = 0.0


@dataclass(frozen=True)
class Followed:
    """How a stream was followed.

    Attributes:
        lag: Shift of least rms against the hand [s].
        transport: Mean transport delay [s].
        rms: Distance at that shift, rms [m].
        path: Length below 3 Hz against the hand's, minus 1.
        violations: Ticks and axes beyond the limits of velocity, acceleration or jerk.
    """

    lag: float
    transport: float
    rms: float
    path: float
    violations: int

    @property
    def beyond(self) -> float:
        """Lag beyond the mean transport delay [s]."""
        return self.lag - self.transport


def run(
    x: Array,
    taken: Array,
    transport: Transport,
    limits: _core.DofLimits,
    option: Option,
    seed: int,
) -> tuple[Array, Array, float]:
    """Ends of ticks (k,) [s], states (k, axes, 3) there, and the mean transport delay [s]."""
    arrivals = transport.arrivals(taken, seed)
    states = _core.stream_filter(
        CLOCK[0] + CLOCK[1] * taken,
        x,
        limits,
        TICK,
        arrivals=arrivals,
        stamped=transport.stamped,
        delay=option.delay,
        tremor=option.tremor,
    )
    ends = arrivals[0] + TICK * np.arange(1, len(states) + 1)
    return ends, states, float(np.mean(arrivals - taken))


def follow(
    hand: Hand,
    seconds: float,
    rate: float,
    transport: Transport,
    limits: _core.DofLimits,
    option: Option = Option(),
    seed: int = 0,
) -> Followed:
    """Sample a hand, send it, follow it, and judge."""
    taken = (np.arange(int(seconds * rate)) + np.random.default_rng(seed).random()) / rate
    ends, states, late = run(hand(taken), taken, transport, limits, option, seed)
    judged = ends > SETTLED
    p, t = states[judged, :, 0], ends[judged]
    grid = np.arange(0, seconds, 0.001)
    truth = hand(grid)

    def off(lag: float) -> float:
        at = np.column_stack([np.interp(t - lag, grid, truth[:, i]) for i in range(3)])
        return float(np.sqrt(np.mean(np.sum((p - at) ** 2, axis=1))))

    coarse = min(np.arange(-0.02, 0.12, 0.004), key=off)
    lag = min(np.arange(coarse - 0.004, coarse + 0.004, 0.0005), key=off)
    wanted = hand(t)
    length = metrics.path_length(p, 1 / TICK, PATH_CUTOFF_HZ)
    return Followed(
        lag=float(lag),
        transport=late,
        rms=off(float(lag)),
        path=length / metrics.path_length(wanted, 1 / TICK, PATH_CUTOFF_HZ) - 1,
        violations=sum(violations(states, limits)),
    )


def gain(
    hertz: float,
    rate: float,
    transport: Transport,
    limits: _core.DofLimits,
    option: Option = Option(),
    size: float = 2e-5,
) -> float:
    """Gain for a sine of so many metres; of 20 um, which no limit touches, if not said."""
    seconds = 12.0
    taken = (np.arange(int(seconds * rate)) + 0.3) / rate
    x = size * np.sin(2 * np.pi * hertz * taken)[:, None]
    t, states, _ = run(x, taken, transport, limits, option, seed=7)
    whole = int(int((t[-1] - 3.0) * hertz) / hertz / TICK)
    y = states[-whole:, 0, 0]
    return float(2 * abs(np.mean(y * np.exp(-2j * np.pi * hertz * t[-whole:]))) / size)
