"""The table of streams: every rate and transport, on held-out hand motions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from helpers.control.hand_motions import strokes, wandering
from helpers.control.stream_transport import Followed, Option, Transport, follow, gain
from surg_core import _core

RATES = (25, 30, 100, 500, 1000, 2000)
TRANSPORTS = (
    Transport(),
    *(Transport(burst=seconds) for seconds in (0.004, 0.010, 0.020, 0.040)),
    Transport(jitter=0.030),
)
HERTZ = (1, 2, 3, 9)
HELD_OUT = ((strokes, 1001), (strokes, 1002), (wandering, 1003), (wandering, 1004))
"""The filter was tuned on strokes with seeds 0 to 2."""
SECONDS = 24.0
UR5E = _core.DofLimits(0.25, 2.0, 100.0)
PANDA = _core.DofLimits(0.25, 0.6, 100.0)
LEAST_TREMOR = 0.87
"""At 8 to 12 Hz, of any linear filter that is 5 ms late at 30 Hz and keeps 5 % below 3 Hz, with a
gain of up to 1.5 elsewhere: the linear program of docs/design/set_points.md."""


@dataclass(frozen=True)
class Row:
    """Means over the hands; lag beyond the mean transport delay [ms], rms [mm], path [%]."""

    lag: float
    beyond: float
    rms: float
    path: float
    gains: tuple[float, ...]
    violations: int

    def cells(self) -> str:
        """The row in Markdown, without its ends."""
        gains = " ".join(f"{g:.2f}" for g in self.gains)
        return f"{self.lag:.1f} ({self.beyond:+.1f}) | {self.rms:.2f} | {self.path:+.1f} | {gains}"


def cases() -> list[tuple[int, Transport]]:
    """Every rate and transport; a burst of one sample is none."""
    return [(r, how) for r in RATES for how in TRANSPORTS if how.burst == 0 or how.burst * r > 1]


@cache
def measure(
    rate: int,
    how: Transport,
    option: Option = Option(),  # noqa: B008 - frozen
    limits: _core.DofLimits = UR5E,
    hands: int = len(HELD_OUT),
) -> Row:
    """One row of the table."""
    runs: list[Followed] = [
        follow(family(seed, SECONDS), SECONDS, rate, how, limits, option, seed)
        for family, seed in HELD_OUT[:hands]
    ]
    return Row(
        lag=1e3 * float(np.mean([r.lag for r in runs])),
        beyond=1e3 * float(np.mean([r.beyond for r in runs])),
        rms=1e3 * float(np.mean([r.rms for r in runs])),
        path=100 * float(np.mean([r.path for r in runs])),
        gains=tuple(gain(f, rate, how, limits, option) for f in HERTZ),
        violations=sum(r.violations for r in runs),
    )


SINES = (0.5, 1.0, 2.0, 3.0, 5.0, 7.0, 9.0)
"""[Hz] Of the gain table."""
SHARES = (0.25, 0.5, 1.0)
"""Peak acceleration of its sines, of what the tip may."""
GAIN_RATES = (30, 60, 100, 500)


@cache
def sine_gain(rate: int, hertz: float, share: float) -> float:
    """Gain of the set-point for a sine with a share of the acceleration, or 0.8 of the velocity."""
    omega = 2 * np.pi * hertz
    size = min(share * UR5E.acceleration / omega**2, 0.8 * UR5E.velocity / omega)
    return gain(hertz, rate, Transport(), UR5E, size=size)


def gain_table() -> str:
    """Markdown of the gains by rate, size and frequency."""
    shares = " | ".join(f"{share:.0%}" for share in SHARES)
    lines = [f"| rate | {shares} |", "|---|---|---|---|"]
    for rate in GAIN_RATES:
        rows = [[f"{sine_gain(rate, f, share):.2f}" for f in SINES] for share in SHARES]
        lines.append(f"| {rate} Hz | {' | '.join(map(' '.join, rows))} |")
    return "\n".join(lines) + "\n"


HEAD = "| rate | transport | lag [ms] | rms [mm] | path [%] | gain 1, 2, 3, 9 Hz |"


def page_rows() -> list[tuple[int, Transport, Option, str]]:
    """What the page shows: three transports, none of them stamped, no tremor, a delay."""
    regular, jitter = TRANSPORTS[0], TRANSPORTS[-1]
    blind = Transport(jitter=jitter.jitter, stamped=False)
    return [
        *(
            (rate, how, Option(), "ur5e")
            for rate in (30, 500)
            for how in (regular, TRANSPORTS[4], jitter)
        ),
        *((rate, blind, Option(), "ur5e") for rate in (30, 500)),
        *((rate, regular, Option(tremor=10.0), "ur5e") for rate in (30, 500)),
        *(
            (rate, regular, Option(delay=delay), "panda")
            for rate in (30, 500)
            for delay in (0, 0.05)
        ),
    ]


def table() -> str:
    """Markdown of the page's rows."""
    lines = [HEAD, "|---" * 6 + "|"]
    for rate, how, option, name in page_rows():
        row = measure(rate, how, option, UR5E if name == "ur5e" else PANDA)
        assert row.violations == 0, (rate, how, option)
        text = [str(how)] + ["panda"] * (name == "panda")
        text += [f"tremor {option.tremor:g} Hz"] * (option.tremor > 0)
        text += [f"delay up to {1e3 * option.delay:g} ms"] * (option.delay > 0)
        lines.append(f"| {rate} Hz | {', '.join(text)} | {row.cells()} |")
    return "\n".join(lines) + "\n"
