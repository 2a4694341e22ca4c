"""The lag of a video against the kinematics, estimated from the motion that both show.

The picture changes much while the tip moves far. For every lag tried, the tip's travel between the
two stamps of a pair of frames, taken at *stamp − lag*, is correlated with the change between the
two frames. The lag of the highest correlation is the estimate; positive: the picture shows an older
state than its stamp says. It is accepted only if it stands out: see ``estimate``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from surg_recording.clock.verdict import CANNOT_TELL, FAIL, PASS
from surg_recording.video.image_motion import ImageMotion

Array = npt.NDArray[np.float64]

SEARCH = 3.0
"""Largest lag tried [s]; at most a third of the video's length."""
MIN_BOUND = 0.05
"""A lag passes up to one frame, or up to this if frames are shorter [s]."""
STILL_WAY = 0.1e-3
"""A tip that moves less between two frames is at rest in a picture [m]."""
MIN_FRAMES = 60
MIN_MOVING = 20
"""Pairs of frames with a moving tip that an estimate needs."""
MIN_SPREAD = 0.25
"""Standard deviation of log(way): a smaller one is a motion without features."""
MIN_CORRELATION = 0.4
MIN_SIGNIFICANCE = 3.3
"""Correlation in multiples of the standard deviation of unrelated motions."""
MAX_WIDTH = 0.25
"""Width of the peak at nine tenths of its height [s]: slow motion cannot be located to a frame."""
MIN_MARGIN = 0.2
"""The next best lag must correlate less than the best by this fraction."""
BLOCK = 2.0
"""Length of the blocks that are compared, each about its own mean [s]: slower changes, as in how
much of the instrument is in view, do not count."""


@dataclasses.dataclass(frozen=True)
class LagEstimate:
    """The result."""

    verdict: str
    reason: str
    lag: float | None = None
    """Positive: the video is late [s]; None if unknown."""
    uncertainty: float | None = None
    """Standard error of the lag from leaving out one block after the other [s]."""
    correlation: float | None = None
    """At the best lag, accepted or not."""
    bound: float | None = None
    """Largest lag that passes [s]."""
    seen: str = ""
    """Arm whose motion the picture follows best."""


@dataclasses.dataclass(frozen=True)
class TipPath:
    """Positions of an arm's tip."""

    t: Array
    """(M,) increasing times [s], on the same clock as the frames' stamps."""
    p: Array
    """(M, 3) positions in any frame that stands still [m]."""


def estimate(stamps: Array, motion: ImageMotion, paths: Mapping[str, TipPath]) -> LagEstimate:
    """Estimate the lag of a video.

    The arms' paths are tried one by one and summed; the best correlation counts. *Cannot tell* when
    nothing moves, the correlation is low or not above what unrelated motions reach by chance
    (Bartlett's formula, which accounts for periodic motion), the motion is too slow, another lag
    fits nearly as well, the best lag lies at the end of the search, or leaving out parts of the
    video moves it by more than a frame.

    Args:
        stamps: (N + 1,) of the frames [s].
        motion: Of the same frames.
        paths: By arm.
    """
    count = min(len(stamps) - 1, len(motion.energy))
    if count < MIN_FRAMES:
        return _unknown(f"only {max(count + 1, 0)} frames, an estimate needs {MIN_FRAMES + 1}")
    stamps, energy = stamps[: count + 1], motion.energy[:count]
    frame = float(np.median(np.diff(stamps)))
    bound = max(frame, MIN_BOUND)
    moving = {name: _moving(path, stamps) for name, path in paths.items()}
    best = max(moving.values(), default=0)
    if best < MIN_MOVING:
        return _unknown(
            f"nothing moves: the tip goes more than {STILL_WAY * 1e3:g} mm between two frames"
            f" {best} times, an estimate needs {MIN_MOVING}"
        )
    if not np.any(energy > 0.0):
        return _unknown("nothing moves in the picture")
    search = min(SEARCH, (stamps[-1] - stamps[0]) / 3.0)
    names = [[name] for name, times in moving.items() if times >= MIN_MOVING]
    if len(names) > 1:
        names.append([name for group in names for name in group])
    tried = [
        _Match(stamps, energy, motion.usable[:count], [paths[n] for n in group], search, frame)
        for group in names
    ]
    first = int(np.argmax([match.peak for match in tried]))
    return tried[first].judge(bound, " and ".join(names[first]))


class _Match:
    """One motion correlated with the picture at every lag."""

    def __init__(
        self,
        stamps: Array,
        energy: Array,
        usable: npt.NDArray[np.bool_],
        paths: list[TipPath],
        search: float,
        frame: float,
    ) -> None:
        self._frame = frame
        step = frame / 4.0
        half = int(np.ceil(search / step))
        self._lags = np.arange(-half, half + 1) * step
        middle = (stamps[1:] + stamps[:-1]) / 2.0
        blocks = int(np.clip(round((stamps[-1] - stamps[0]) / BLOCK), 4, 64))
        block = np.minimum((np.arange(len(middle)) * blocks) // len(middle), blocks - 1)
        seen = np.log(energy + 0.2 * float(np.mean(energy)))
        # Per lag and block: sums about the block's mean of way², seen², way · seen.
        self._sums = np.zeros((len(self._lags), blocks, 3))

        def centred(lag: float) -> tuple[Array, Array, int]:
            way, inside = _way(paths, stamps - lag)
            good = usable & inside
            log_way = np.log(way + STILL_WAY)
            w, s = (_centred(values, good, block, blocks) for values in (log_way, seen))
            return w, s, int(np.sum(good))

        for i, lag in enumerate(self._lags):
            w, s, _ = centred(lag)
            sums = [np.bincount(block, x, blocks) for x in (w * w, s * s, w * s)]
            self._sums[i] = np.stack(sums, axis=1)
        self._r = _correlation(self._sums.sum(axis=1))
        self._best = int(np.argmax(self._r))
        self.peak = float(self._r[self._best])
        self._way, self._seen, self._count = centred(self._lags[self._best])

    def judge(self, bound: float, who: str) -> LagEstimate:
        """The estimate, or why there is none."""

        def unknown(reason: str) -> LagEstimate:
            return _unknown(reason, self.peak, bound, who)

        spread = float(np.sqrt(np.sum(self._way**2) / max(self._count, 1)))
        if spread < MIN_SPREAD:
            return unknown("the tip moves so evenly that no moment of it can be recognised")
        chance = self._chance()
        if self.peak < max(MIN_CORRELATION, MIN_SIGNIFICANCE * chance):
            return unknown(
                f"the picture does not follow the tip (correlation {self.peak:.2f},"
                f" by chance up to {MIN_SIGNIFICANCE * chance:.2f}):"
                " is the instrument in view, and is something else moving?"
            )
        if not 0 < self._best < len(self._lags) - 1:
            return unknown(f"the best fit lies at the end of the search, {self._seconds():+.2f} s")
        width = self._width()
        if width > MAX_WIDTH:
            return unknown(
                f"the motion is too slow to be placed: lags over {width:.2f} s fit about equally"
            )
        rival = self._rival()
        if rival is not None and self._r[rival] > (1.0 - MIN_MARGIN) * self.peak:
            return unknown(
                f"the motion repeats itself: lags of {self._seconds():+.2f} s and"
                f" {self._lags[rival]:+.2f} s fit nearly as well"
            )
        lag, error = _vertex(self._lags, self._r, self._best), self._jackknife()
        if 2.0 * error > max(self._frame, MIN_BOUND):
            return unknown(
                f"parts of the video disagree: {lag * 1e3:+.0f} ms, give or take"
                f" {2e3 * error:.0f} ms"
            )
        late = "late" if lag > 0 else "early"
        passed = abs(lag) <= bound
        reason = (
            f"the video is {abs(lag) * 1e3:.0f} ms {late} against {who}"
            f" (± {2e3 * error:.0f} ms), allowed are {bound * 1e3:.0f} ms"
        )
        verdict = PASS if passed else FAIL
        return LagEstimate(verdict, reason, lag, error, self.peak, bound, who)

    def _seconds(self) -> float:
        return float(self._lags[self._best])

    def _chance(self) -> float:
        """Standard deviation of the correlation of two unrelated signals like these (Bartlett)."""
        product = _autocorrelation(self._way) * _autocorrelation(self._seen)
        count = max(self._count, 1)
        shape = 1.0 - np.arange(len(product)) / len(product)
        return float(np.sqrt(max((2.0 * np.sum(shape * product) - product[0]) / count, 1 / count)))

    def _width(self) -> float:
        """Range of lags with at least nine tenths of the best correlation [s]."""
        low = np.flatnonzero(self._r < 0.9 * self.peak)
        left = low[low < self._best].max(initial=0)
        right = low[low > self._best].min(initial=len(self._r) - 1)
        return float(self._lags[right] - self._lags[left])

    def _rival(self) -> int | None:
        """The highest other maximum, beyond the valleys on both sides of the best."""
        left = right = self._best
        while left > 0 and self._r[left - 1] <= self._r[left]:
            left -= 1
        while right < len(self._r) - 1 and self._r[right + 1] <= self._r[right]:
            right += 1
        # A shoulder closer than this is the same maximum.
        near = max(0.15, 3.0 * self._frame)
        outside = np.abs(self._lags - self._lags[self._best]) > near
        outside[left : right + 1] = False
        if not np.any(outside):
            return None
        return int(np.flatnonzero(outside)[np.argmax(self._r[outside])])

    def _jackknife(self) -> float:
        """Standard error of the lag when one block after the other is left out [s]."""
        total, lags = self._sums.sum(axis=1), []
        blocks = self._sums.shape[1]
        for b in range(blocks):
            r = _correlation(total - self._sums[:, b])
            lags.append(_vertex(self._lags, r, int(np.argmax(r))))
        return float(np.sqrt((blocks - 1) * np.var(lags)))


def _moving(path: TipPath, stamps: Array) -> int:
    """Number of pairs of frames between which the tip moves."""
    way, inside = _way([path], stamps)
    return int(np.sum(way[inside] > STILL_WAY))


def _way(paths: list[TipPath], t: Array) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Travel of the tips from one time to the next, summed [m], and where it is known."""
    way = np.zeros(len(t) - 1)
    known = np.ones(len(t), dtype=bool)
    for path in paths:
        p = np.stack([np.interp(t, path.t, path.p[:, i]) for i in range(3)], axis=1)
        way += np.linalg.norm(np.diff(p, axis=0), axis=1)
        known &= (t >= path.t[0]) & (t <= path.t[-1])
    return way, known[1:] & known[:-1]


def _centred(
    values: Array, good: npt.NDArray[np.bool_], block: npt.NDArray[np.int64], blocks: int
) -> Array:
    """Values minus the mean of their block; 0 where they do not count."""
    weight = good.astype(float)
    number = np.maximum(np.bincount(block, weight, blocks), 1.0)
    mean = np.bincount(block, weight * values, blocks) / number
    return np.asarray(weight * (values - mean[block]))


def _correlation(sums: Array) -> Array:
    """(L,) correlations from (L, 3) sums; 0 where one of the two does not vary."""
    scale = np.sqrt(sums[:, 0] * sums[:, 1])
    return np.where(scale > 1e-12, sums[:, 2] / np.maximum(scale, 1e-12), 0.0)


def _autocorrelation(values: Array) -> Array:
    """(n,) autocorrelation from lag 0 on, up to a quarter of the length."""
    size = 1 << (2 * len(values) - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(values, size)) ** 2
    correlation = np.fft.irfft(spectrum, size)[: max(len(values) // 4, 2)]
    return np.asarray(
        correlation / correlation[0] if correlation[0] > 0 else np.eye(1, len(correlation))[0]
    )


def _vertex(x: Array, y: Array, i: int) -> float:
    """Vertex of the parabola through three points about the i-th."""
    if not 0 < i < len(x) - 1:
        return float(x[i])
    below, above = y[i] - y[i - 1], y[i] - y[i + 1]
    curve = below + above
    shift = 0.5 * (below - above) / curve if curve > 0 else 0.0
    return float(x[i] + shift * (x[1] - x[0]))


def _unknown(
    reason: str, correlation: float | None = None, bound: float | None = None, who: str = ""
) -> LagEstimate:
    return LagEstimate(CANNOT_TELL, reason, None, None, correlation, bound, who)
