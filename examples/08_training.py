#!/usr/bin/env python3
"""Step 8: train a policy on the dataset: behaviour cloning by linear least squares.

You learn: how to read the dataset into arrays and what a policy for the model server must predict.
The policy is one matrix: next set-point - set-point = W [set-point, ball, 1]. A policy for a real
task needs more: surg_learn.bgr trains a network, and ``./surg learn bgr`` runs the whole chain.

    ./surg dev shell -c "python3 examples/08_training.py"      # writes runs/course/weights.npz
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from pyarrow import parquet

STATE, TASK, ACTION = "observation.state", "privileged.task_state", "action"


def main() -> None:
    """Fit, report the error on the validation split, save."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("dataset", type=Path, nargs="?", default=Path("runs/course/dataset"))
    parser.add_argument("--out", type=Path, default=Path("runs/course/weights.npz"))
    options = parser.parse_args()
    try:
        info = json.loads((options.dataset / "meta" / "info.json").read_text("utf-8"))
    except OSError as error:
        raise SystemExit(f"{error}; run examples/07_export.py first") from None

    def columns(feature: str, wanted: list[str]) -> list[int]:
        names = info["features"][feature]["names"]
        return [names.index(name) for name in wanted]

    set_point = columns(STATE, ["PSM1/set_x", "PSM1/set_y", "PSM1/set_z"])  # rcm frame [m]
    ball = columns(TASK, ["ball_0", "ball_1", "ball_2"])  # world [m]
    target = columns(ACTION, ["PSM1/x", "PSM1/y", "PSM1/z"])  # rcm frame [m]

    inputs, steps, split = [], [], []
    last = int(info["splits"]["train"].split(":")[1])  # episodes 0:last are for training
    for file in sorted((options.dataset / "data").rglob("*.parquet")):
        table = parquet.read_table(file)
        s, z, a = (np.stack(table[name].to_numpy()) for name in (STATE, TASK, ACTION))
        inputs.append(np.hstack([s[:, set_point], z[:, ball], np.ones((len(s), 1))]))
        steps.append(a[:, target] - s[:, set_point])
        split.append(table["episode_index"].to_numpy() < last)
    x, y, train = np.vstack(inputs), np.vstack(steps), np.concatenate(split)
    W, *_ = np.linalg.lstsq(x[train], y[train], rcond=None)
    error = 1e3 * np.sqrt(np.mean((x[~train] @ W - y[~train]) ** 2))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    np.savez(options.out, W=W)
    print(f"{train.sum()} frames for training, {(~train).sum()} for validation")
    print(f"validation error {error:.2f} mm rms per step -> {options.out}")


if __name__ == "__main__":
    main()
