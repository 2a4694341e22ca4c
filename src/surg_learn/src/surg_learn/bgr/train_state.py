"""Trains the policy of `state_policy.py` on a LeRobot dataset (v2.1) of `./surg episode export`.

    python3 -m surg_learn.bgr.train_state datasets/bgr --out weights.npz --seed 0

Behaviour cloning of action chunks with a small multilayer perceptron, in plain numpy: the same
dataset, options and seed give the same weights. It trains on the split `train` and prints the
losses on `train` and `val`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from surg_learn.bgr.observed_features import DISTANCE, ROBOT, TENSION, Columns, features, world_of
from surg_learn.bgr.state_policy import Policy
from surg_learn.bgr.training.action_head import HandOptions, Samples, fit_hand, may_move
from surg_learn.bgr.training.perceptron import mean_error, size_of
from surg_learn.cloning.arm_columns import ACTION, FORCE, SET, STATE, TASK, Array, force_columns
from surg_learn.cloning.training.lerobot_dataset import (
    Dataset,
    Progress,
    facts,
    flat_names,
    jaw_range,
    last_commands,
    normalised,
    scales_of,
    split_episodes,
    table,
    targets_of,
)
from surg_learn.cloning.training.trainer_options import brief_of, chosen, parser_of, trained


@dataclass(frozen=True)
class Options(HandOptions):
    """Training options."""

    forces: bool = False
    """Read `observation.force`, too."""
    tension: bool = True
    """Read the tissue's tension in the simulator's truth."""


@dataclass
class Episode:
    """One recording of T steps."""

    state: Array
    task: Array
    action: Array
    force: Array | None = None
    """(T, 8) of `force_columns`; None: trained without."""


def read(folder: Path, forces: bool = False) -> Dataset[Episode]:
    """Read the tables of a dataset, with or without its forces.

    Raises:
        ValueError: The folder is no dataset, or a required feature is missing.
    """
    needed = (STATE, TASK, ACTION, *((FORCE,) if forces else ()))
    info = facts(folder, needed)
    names = {name: flat_names(info["features"][name]["names"]) for name in needed}
    episodes: dict[str, list[Episode]] = {}
    for split, index in split_episodes(info):
        columns = table(folder, info, index, needed)
        if forces:
            columns[3] = columns[3][:, force_columns(names[FORCE], ROBOT)]
        episodes.setdefault(split, []).append(Episode(*columns))
    return Dataset(episodes, names, {"fps": info["fps"], "robot": info["robot_type"]})


def samples(
    episodes: Sequence[Episode], columns: Columns, X_RW: Array, chunk: int, behind: int = 0
) -> Samples:
    """The steps of all episodes, in order.

    Args:
        episodes: Of the dataset.
        columns: Of the observations.
        X_RW: (4, 4) pose of the world in the rcm frame.
        chunk: Actions ahead.
        behind: Each step appears with its own observation and with each of the ``behind`` earlier
            ones. Last command and target are those of the step itself.
    """
    parts = []
    for episode in episodes:
        last = last_commands(episode.state, episode.action, columns.state[SET])
        targets = targets_of(episode.action, last, chunk)
        for steps in range(behind + 1):
            row = np.maximum(np.arange(len(last)) - steps, 0)
            state, task = episode.state[row], episode.task[row]
            felt = None if episode.force is None else episode.force[row]
            inputs = features(columns, state, task, last, X_RW, felt)
            jaw, held = state[:, columns.state[4]], task[:, columns.task["held"]].ravel()
            parts.append((inputs, targets, may_move(held, jaw, inputs[:, DISTANCE]), jaw))
    return Samples.joined(parts, places=DISTANCE)


def train(
    dataset: Dataset[Episode],
    options: Options,
    progress: Progress = lambda part, note: None,
) -> Policy:
    """Train on the split ``train``.

    Raises:
        ValueError: The split is empty.
    """
    columns = Columns(dataset.names[STATE], dataset.names[TASK])
    shown = dataset.episodes.get("train")
    if not shown:
        raise ValueError("the dataset has no episode in its split 'train'")
    X_RW = world_of(shown, columns)
    parts = {
        split: samples(episodes, columns, X_RW, options.chunk, options.behind)
        for split, episodes in dataset.episodes.items()
    }
    known = parts["train"]
    scales = {
        **scales_of(known.inputs, known.targets),
        "jaw_range": jaw_range(known.targets),
        "X_RW": X_RW,
    }
    if not options.tension:
        scales["input_std"][TENSION] = np.inf
    network = fit_hand(known, scales, options, dataset.about["fps"], progress)
    losses = {
        split: mean_error(network, *normalised(scales, part.inputs, part.targets))
        for split, part in parts.items()
    }
    about = {
        "options": asdict(options),
        "dataset": dataset.about,
        "episodes": {split: len(found) for split, found in dataset.episodes.items()},
        "frames": sum(len(episode.state) for episode in shown),
        "parameters": size_of(network),
        "loss": losses,
        "observation": [STATE, TASK, *([FORCE] if options.forces else [])],
        "privileged": [TASK],
    }
    return Policy(network, scales, dataset.names, options.chunk, about)


def main(words: Sequence[str] | None = None) -> int:
    """Entry point; returns 0, or 2 for an unusable dataset."""
    parser = parser_of("train_state", (__doc__ or "").split("\n")[0])
    parser.add_argument(
        "--forces", action="store_true", default=argparse.SUPPRESS, help="read observation.force"
    )
    parser.add_argument(
        "--no-tension",
        dest="tension",
        action="store_false",
        default=argparse.SUPPRESS,
        help="do not read the tissue's tension, which no robot measures",
    )

    given = parser.parse_args(words)

    def make(show: Progress) -> Policy:
        options = chosen(Options, given)
        return train(read(given.dataset, options.forces), options, show)

    return trained(parser.prog, given, make, brief_of)


if __name__ == "__main__":
    sys.exit(main())
