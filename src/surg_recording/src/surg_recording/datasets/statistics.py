"""Statistics of features in float64, exact per recording and for a whole dataset.

Pictures are counted as histograms of their 256 levels, so that minimum, mean, deviation and
quantiles of any number of recordings follow from sums of integers, without growing rounding
errors. Standard deviations are those of the population (divided by N), as in lerobot.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Stats = dict[str, Array]

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}


def of_column(values: npt.NDArray[np.generic], quantiles: bool = False) -> Stats:
    """Statistics of (N, D) or (N,) numbers; min, max, mean, std are (D,), count is (1,)."""
    data = np.asarray(values, dtype=np.float64)
    data = data.reshape(len(data), -1)
    mean = data.mean(axis=0)
    stats = {
        "min": data.min(axis=0),
        "max": data.max(axis=0),
        "mean": mean,
        "std": np.sqrt(np.mean((data - mean) ** 2, axis=0)),
        "count": np.array([len(data)], dtype=np.int64),
    }
    if quantiles:
        for name, share in QUANTILES.items():
            stats[name] = np.quantile(data, share, axis=0)
    return stats


def of_histogram(histogram: npt.NDArray[np.int64], sampled: int, quantiles: bool = False) -> Stats:
    """Statistics of a picture's channels in [0, 1], (3, 1, 1) each.

    ``histogram`` (3, 256) counts the levels of ``sampled`` frames.
    """
    levels = np.arange(256) / 255.0
    total = histogram.sum(axis=1)
    mean = (histogram * levels).sum(axis=1) / total
    variance = (histogram * (levels[None] - mean[:, None]) ** 2).sum(axis=1) / total
    present = histogram > 0
    stats = {
        "min": levels[present.argmax(axis=1)],
        "max": levels[255 - present[:, ::-1].argmax(axis=1)],
        "mean": mean,
        "std": np.sqrt(variance),
    }
    if quantiles:
        below = histogram.cumsum(axis=1)
        for name, share in QUANTILES.items():
            stats[name] = levels[(below >= share * total[:, None]).argmax(axis=1)]
    shaped: Stats = {key: value.reshape(3, 1, 1) for key, value in stats.items()}
    shaped["count"] = np.array([sampled], dtype=np.int64)
    return shaped


def to_json(stats: Mapping[str, Stats]) -> dict[str, dict[str, object]]:
    """Statistics by feature, as lists."""
    return {
        feature: {key: value.tolist() for key, value in values.items()}
        for feature, values in stats.items()
    }


def differ(
    stated: Mapping[str, Mapping[str, object]],
    computed: Mapping[str, Stats],
    features: Sequence[str],
) -> list[str]:
    """Where stated statistics differ from the computed ones, in words."""
    errors = []
    for feature in features:
        for key, value in computed[feature].items():
            claimed = stated.get(feature, {}).get(key)
            if claimed is None or not np.allclose(
                np.asarray(claimed, float), value, rtol=1e-9, atol=1e-12
            ):
                errors.append(
                    f"statistics of {feature}: {key} is {claimed}, computed {value.tolist()}"
                )
    return errors
