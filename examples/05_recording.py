#!/usr/bin/env python3
"""Step 5: record episodes of your task and read a recording.

You learn: what an episode folder holds, and how to read its tables as arrays. ``./surg record`` and
``./surg run`` write the same folders from a ROS graph; docs/reference/recording.md lists all files.

    ./surg dev shell -c "python3 examples/05_recording.py"     # writes runs/course/episodes
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from surg_recording import metrics
from surg_recording.episode import episode_reader
from surg_sim.envs import demonstrations
from surg_sim.physics import cell_files
from surg_sim.tasks import episode_seeds

TASK = Path(__file__).resolve().with_name("04_task.py")


def read(folder: Path) -> None:
    """Print what a recording says of itself and compute a metric from its tables."""
    episode = episode_reader.read(folder)
    run, result = episode.manifest["run"], episode.manifest["sim"]["task"]
    print(f"{folder}: {run['title']}, seed {run['seed']}, success {result['success']}")
    print("tables:", ", ".join(episode.tables))

    cycle = episode.cycle("PSM1")  # one row per control cycle, 500 Hz
    tip, axis, rcm = (cycle.vector(name) for name in ("p_tip", "s", "p_rcm"))  # (n, 3) each, base
    deviation = 1e3 * metrics.rcm_deviation(tip, axis, rcm)
    path = 1e3 * float(np.linalg.norm(np.diff(tip, axis=0), axis=1).sum())
    print(f"{len(cycle)} cycles, tip path {path:.1f} mm")
    print(f"RCM deviation: mean {deviation.mean():.4f} mm, max {deviation.max():.4f} mm")


def main() -> None:
    """Record, then read the first episode."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("runs/course/episodes"))
    parser.add_argument("--episodes", type=int, default=20)
    options = parser.parse_args()
    plan = demonstrations.DemonstrationPlan(options.out, cell_files.find("sim_two_arms"), str(TASK))
    seeds = episode_seeds.training_seeds(options.episodes)
    made = demonstrations.play(plan, seeds)  # recordings that are complete are kept
    print(f"{len(made)} episodes recorded, {len(seeds) - len(made)} were there already")
    read(plan.folder(seeds[0]))


if __name__ == "__main__":
    main()
