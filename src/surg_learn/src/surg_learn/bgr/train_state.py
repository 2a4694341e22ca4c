"""Trains the policy of `state_policy.py` on a LeRobot dataset (v2.1) of `./surg episode export`.

    python3 -m surg_learn.bgr.train_state datasets/bgr --out weights.npz --seed 0

Behaviour cloning of action chunks with a small multilayer perceptron, in plain numpy: the same
dataset, options and seed give the same weights. It trains on the split `train` and prints the
losses on `train` and `val`.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from surg_learn.bgr.observed_features import DISTANCE, Columns, features, world_of
from surg_learn.bgr.state_policy import Policy
from surg_learn.bgr.training.action_head import HandOptions, Samples, hand_of
from surg_learn.bgr.training.perceptron import size_of
from surg_learn.cloning.arm_columns import ACTION, STATE, TASK, Array
from surg_learn.cloning.training.lerobot_dataset import (
    Dataset,
    Progress,
    facts,
    names_of,
    recordings,
)
from surg_learn.cloning.training.trainer_options import brief_of, chosen, parser_of, trained

NEEDED = (STATE, TASK, ACTION)


@dataclass
class Episode:
    """One recording of T steps."""

    state: Array
    task: Array
    action: Array

    def inputs(self, columns: Columns, X_RW: Array, row: Array, last: Array) -> Array:
        """Of the hand, see `Inputs`."""
        return features(columns, self.state[row], self.task[row], last, X_RW)


def read(folder: Path) -> Dataset[Episode]:
    """Read the tables of a dataset.

    Raises:
        ValueError: The folder is no dataset, or a required feature is missing.
    """
    info = facts(folder, NEEDED)
    episodes: dict[str, list[Episode]] = {}
    for split, found in recordings(folder, info, NEEDED):
        episodes.setdefault(split, []).append(Episode(*found.values()))
    about = {"fps": info["fps"], "robot": info["robot_type"]}
    return Dataset(episodes, names_of(info, NEEDED), about)


def samples(
    episodes: Sequence[Episode], columns: Columns, X_RW: Array, chunk: int, behind: int = 0
) -> Samples:
    """The steps of all episodes, see `Samples.of`; X_RW (4, 4): the world in the rcm frame."""
    steps = [
        (each, partial(each.inputs, columns, X_RW), np.arange(len(each.state))) for each in episodes
    ]
    return Samples.of(steps, columns, chunk, behind, DISTANCE)


def train(
    dataset: Dataset[Episode],
    options: HandOptions,
    progress: Progress = lambda part, note: None,
) -> Policy:
    """Train on the split ``train``.

    Raises:
        ValueError: The split is empty.
    """
    columns = Columns(dataset.names[STATE], dataset.names[TASK])
    if not dataset.episodes.get("train"):
        raise ValueError("the dataset has no episode in its split 'train'")
    X_RW = world_of(dataset.episodes["train"], columns)
    parts = {
        split: samples(episodes, columns, X_RW, options.chunk, options.behind)
        for split, episodes in dataset.episodes.items()
    }
    network, scales, about = hand_of(parts, dataset, options, progress)
    about |= {
        "parameters": size_of(network),
        "observation": [STATE, TASK],
        "privileged": [TASK],
    }
    return Policy(network, {**scales, "X_RW": X_RW}, dataset.names, options.chunk, about)


def main(words: Sequence[str] | None = None) -> int:
    """Entry point; returns 0, or 2 for an unusable dataset."""
    parser = parser_of("train_state", (__doc__ or "").split("\n")[0])
    given = parser.parse_args(words)

    def make(show: Progress) -> Policy:
        return train(read(given.dataset), chosen(HandOptions, given), show)

    return trained(parser.prog, given, make, brief_of)


if __name__ == "__main__":
    sys.exit(main())
