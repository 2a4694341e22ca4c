#!/usr/bin/env python3
"""Step 6: evaluate recorded episodes: success, RCM deviation and smoothness.

You learn: how to compute the numbers of ``./surg episode evaluate`` in Python. That command writes
the same as a report with figures and tables: ``./surg episode evaluate runs/course/episodes``.

    ./surg dev shell -c "python3 examples/06_evaluation.py"  # reads runs/course/episodes of step 5
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from surg_recording.episode import episode_reader
from surg_recording.metrics.confidence_intervals import success_rate
from surg_recording.recording_errors import EpisodeError
from surg_recording.reports import evaluation


def main() -> None:
    """Measure every episode and summarise them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("episodes", type=Path, nargs="?", default=Path("runs/course/episodes"))
    options = parser.parse_args()
    try:
        folders = episode_reader.find([options.episodes])
    except EpisodeError as error:
        raise SystemExit(f"{error}; run examples/05_recording.py first") from None
    entries, left_out = evaluation.measure_all(folders, "PSM1", False, lambda part, note: None)

    rate = success_rate([entry["success"] for entry in entries])
    print(f"{len(entries)} episodes, {len(left_out)} left out")
    print(f"success {rate['k']} of {rate['n']} (95 %: {rate['low']:.1%} to {rate['high']:.1%})")
    for metric in evaluation.METRICS:
        values = metric.values(entries, "reference")
        if values:
            low, middle, high = np.quantile(values, (0.25, 0.5, 0.75))
            print(
                f"{metric.title:18} {middle:8.4g} {metric.unit:2}  quartiles {low:.4g}, {high:.4g}"
            )


if __name__ == "__main__":
    main()
