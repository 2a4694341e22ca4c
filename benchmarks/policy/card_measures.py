"""What is measured of an episode of a score card."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from surg_core.contract import FORCE_TICKS, GRID, GRID_RATE, TICK
from surg_recording.metrics import path_length, smoothness
from surg_sim.envs.cell_session import CellSession, Tick


class Measures:
    """What is measured of an episode, from the first motion of the commanded arms on; SI.

    Forces and the true deviation are sampled at 100 Hz, as the sensors do, the tip at 20 Hz.
    """

    NAMES = (
        *("duration_s", "rcm_mean_m", "rcm_max_m", "rcm_true_max_m"),
        *("trocar_force_mean_n", "trocar_force_max_n", "tip_force_mean_n", "tip_force_max_n"),
        *("path_m", "sparc"),
    )

    def __init__(self, session: CellSession) -> None:
        self._session = session
        self._rcm: list[float] = []
        self._felt: list[tuple[float, float, float]] = []  # deviation, at the trocar, at the tip
        self._tips: dict[str, list[np.ndarray]] = {arm: [] for arm in session.task.commanded}
        self.last: Tick | None = None

    def __call__(self, tick: Tick) -> None:
        """After a tick."""
        self.last, world = tick, self._session.world
        for arm, tips in self._tips.items():
            out = tick.outputs[arm]
            if int(out.accepted) == 0:
                continue
            self._rcm.append(out.rcm_error)
            if tick.tick % FORCE_TICKS == 0:
                truth, tip = world.truth(arm), world.tip_force(arm)
                force = np.nan if tip is None else float(np.linalg.norm(tip))
                at_trocar = float(np.linalg.norm(truth.trocar_force))
                self._felt.append((truth.deviation, at_trocar, force))
            if tick.tick % GRID == 0:
                tips.append(np.array(out.p_BTip))

    @property
    def values(self) -> dict[str, float | None]:
        """By name; None where there is nothing to measure."""
        deviation, trocar, tip = np.array(self._felt).reshape(-1, 3).T
        paths = [path_length(tips) for tips in self._tips.values() if len(tips) > 1]
        smooth = [_sparc(tips) for tips in self._tips.values()]
        found = (
            *(self.last.tick * TICK if self.last else None, *_spread(np.array(self._rcm))),
            *(_spread(deviation)[1], *_spread(trocar), *_spread(tip[np.isfinite(tip)])),
            *(sum(paths) if paths else None, min((s for s in smooth if s), default=None)),
        )
        return dict(zip(self.NAMES, found, strict=True))


def _spread(values: np.ndarray) -> tuple[float | None, float | None]:
    """Mean and largest."""
    return (float(np.mean(values)), float(np.max(values))) if len(values) else (None, None)


def _sparc(tips: Sequence[np.ndarray]) -> float | None:
    if len(tips) < GRID_RATE:  # shorter than a second: no spectrum
        return None
    value = smoothness(tips, GRID_RATE).sparc
    return value if np.isfinite(value) else None
