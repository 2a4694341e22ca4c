"""Trains the policy of `bgr_policy.py` on a LeRobot dataset (v2.1) that `./surg export` wrote.

    python3 examples/bgr/train_bgr.py datasets/bgr --out weights.npz --seed 0

Behaviour cloning of action chunks with a small multilayer perceptron, in plain numpy: the same
dataset, options and seed give the same weights. Reads the split `train`; says what the loss is on
it and on `val`.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from bgr_policy import (
    ACTION,
    DISTANCE,
    HERE,
    PLACES,
    SET,
    STATE,
    TASK,
    Columns,
    Network,
    Policy,
    features,
    world_in_rcm,
)
from bgr_training import (
    Adam,
    Array,
    Dataset,
    Progress,
    command_line,
    facts,
    flat_layers,
    flat_names,
    gradient_of,
    last_commands,
    split_episodes,
    table,
    targets_of,
)

OPEN, NEAR = 0.6, 0.03
"""Jaws that are less open [rad] so near to the asked node [m] are about to hold it."""
THERE = 0.0015
"""Jaws may close when they are so near to where they were to close [m]."""


@dataclass(frozen=True)
class Options:
    """What may be chosen; chosen with tuning seeds."""

    chunk: int = 16
    """Actions predicted at once."""
    hidden: tuple[int, ...] = (256, 256)
    steps: int = 5000
    """Of the optimiser."""
    batch: int = 256
    rate: float = 1.5e-3
    """Of learning, at first; falls to nothing along half a cosine."""
    decay: float = 1e-4
    """Of weights."""
    noise: float = 0.02
    """Added to normalised inputs,"""
    noise_place: float = 0.3
    """and to the last command: what is learned shall not depend on the place."""
    push: float = 0.004
    """Spread of what every second sample of a free arm is moved aside by, per axis [m],"""
    back: float = 0.25
    """and time constant of its way back [s]."""
    behind: int = 2
    """Steps by which what is seen may be behind what was said, 0 to this: in real time it is."""
    seed: int = 0


@dataclass
class Episode:
    """One recording of the dataset: T steps."""

    state: Array
    task: Array
    action: Array


def read(folder: Path) -> Dataset[Episode]:
    """Read the tables of a dataset.

    Raises:
        ValueError: It is none, or lacks a feature that is needed.
    """
    needed = (STATE, TASK, ACTION)
    info = facts(folder, needed)
    names = {name: flat_names(info["features"][name]["names"]) for name in needed}
    episodes: dict[str, list[Episode]] = {}
    for split, index in split_episodes(info):
        columns = table(folder, info, index, needed)
        episodes.setdefault(split, []).append(Episode(*columns))
    return Dataset(episodes, names, {"fps": info["fps"], "robot": info["robot_type"]})


@dataclass
class Samples:
    """Steps to learn from, N in all; SI.

    Attributes:
        inputs: (N, F) of `features`.
        targets: (N, K, 5) of `targets_of`.
        free: (N,) whether the arm might as well be a little beside where it is: nothing is held or
            about to be.
        jaw: (N,) jaw angle [rad].
    """

    inputs: Array
    targets: Array
    free: Array
    jaw: Array

    @classmethod
    def of(
        cls,
        episodes: Sequence[Episode],
        columns: Columns,
        X_RW: Array,
        chunk: int,
        behind: int = 0,
    ) -> Samples:
        """The steps of episodes, one after another.

        Args:
            episodes: Of the dataset.
            columns: Where what is in the observations.
            X_RW: (4, 4) the world in the rcm frame.
            chunk: Actions ahead.
            behind: Each step is there with its own observation and with each of as many before it;
                what was said last and what is to be said are those of the step itself.
        """
        parts = []
        for episode in episodes:
            last = last_commands(episode, columns.state[SET])
            targets = targets_of(episode, last, chunk)
            for steps in range(behind + 1):
                row = np.maximum(np.arange(len(last)) - steps, 0)
                state, task = episode.state[row], episode.task[row]
                inputs = features(columns, state, task, last, X_RW)
                held = task[:, columns.task["held"]] >= 0
                jaw = state[:, columns.state[4]]
                free = ~held & ((jaw > OPEN) | (inputs[:, DISTANCE] > NEAR))
                parts.append((inputs, targets, free, jaw))
        return cls(*(np.concatenate(part) for part in zip(*parts, strict=True)))

    def pushed(self, rows: Array, push: Array, left: Array) -> tuple[Array, Array]:
        """Some steps as they would be with the arm beside where it was, and on its way back.

        An arm that is free goes where it is told, so that what it should do there is known: close
        the gap. Its jaws do not close before that.

        Args:
            rows: (B,) of the samples.
            push: (B, 3) by how much they are aside [m].
            left: (K,) share of it that is left at each step of the chunk.

        Returns:
            Inputs (B, F) and targets (B, K, 5).
        """
        x, y, jaw = self.inputs[rows], self.targets[rows], self.jaw[rows][:, None]
        push = push * self.free[rows][:, None]
        x[:, PLACES] -= np.tile(push, 3)
        x[:, DISTANCE] = np.linalg.norm(x[:, :3], axis=1)
        x[:, HERE] += push
        y[:, :, :3] += push[:, None, :] * (left - 1.0)[:, None]
        far = np.linalg.norm(push, axis=1)[:, None] * left > THERE
        y[:, :, 4] = np.where(far, np.maximum(y[:, :, 4], jaw), y[:, :, 4])
        return x, y


def train(
    dataset: Dataset[Episode],
    options: Options,
    progress: Progress = lambda part, note: None,
) -> Policy:
    """Train on the split ``train``.

    Raises:
        ValueError: There is nothing to train on.
    """
    columns = Columns(dataset.names[STATE], dataset.names[TASK])
    shown = dataset.episodes.get("train")
    if not shown:
        raise ValueError("the dataset has no episode in its split 'train'")
    tips = [episode.state[:, columns.state[:3]] for episode in shown]
    tips_W = [episode.task[:, columns.task["tip"]] for episode in shown]
    X_RW = world_in_rcm(np.concatenate(tips), np.concatenate(tips_W))
    parts = {
        split: Samples.of(episodes, columns, X_RW, options.chunk, options.behind)
        for split, episodes in dataset.episodes.items()
    }
    known = parts["train"]
    flat_targets = known.targets.reshape(len(known.targets), -1)
    scales = {
        "input_mean": known.inputs.mean(axis=0),
        "input_std": np.maximum(known.inputs.std(axis=0), 1e-3),
        "output_mean": flat_targets.mean(axis=0),
        "output_std": np.maximum(flat_targets.std(axis=0), 1e-4),
        "X_RW": X_RW,
        "jaw_range": np.array([known.targets[:, :, 4].min(), known.targets[:, :, 4].max()]),
    }

    def normal(inputs: Array, targets: Array) -> tuple[Array, Array]:
        x = (inputs - scales["input_mean"]) / scales["input_std"]
        y = (targets.reshape(len(x), -1) - scales["output_mean"]) / scales["output_std"]
        return x.astype(np.float32), y.astype(np.float32)

    rng = np.random.default_rng(options.seed)
    sizes = [known.inputs.shape[1], *options.hidden, 5 * options.chunk]
    shapes = list(itertools.pairwise(sizes))
    flat, layers = flat_layers(shapes)
    for weight, _ in layers:
        weight[:] = rng.standard_normal(weight.shape) * np.sqrt(2.0 / len(weight))
    layers[-1][0][:] *= 0.1
    network, adam = Network(layers), Adam(flat, options.decay)
    slope, grads = flat_layers(shapes)
    noise = np.full(sizes[0], options.noise, np.float32)
    noise[HERE] = options.noise_place
    left = np.exp(-np.arange(1, options.chunk + 1) / (options.back * dataset.about["fps"]))
    for step in range(options.steps):
        rows = rng.integers(0, len(known.inputs), options.batch)
        push = options.push * rng.standard_normal((options.batch, 3))
        push[::2] = 0.0
        x, y = normal(*known.pushed(rows, push, left))
        x += noise * rng.standard_normal(x.shape, np.float32)
        loss = gradient_of(network, grads, x, y)
        adam.step(slope, options.rate * 0.5 * (1 + np.cos(np.pi * step / options.steps)))
        if step % 50 == 0:
            progress(step / options.steps, f"step {step} of {options.steps}, loss {loss:.4f}")
    losses = {
        split: _loss(network, *normal(part.inputs, part.targets)) for split, part in parts.items()
    }
    about = {
        "options": asdict(options),
        "dataset": dataset.about,
        "episodes": {split: len(found) for split, found in dataset.episodes.items()},
        "frames": sum(len(episode.state) for episode in shown),
        "parameters": int(flat.size),
        "loss": losses,
        "observation": [STATE, TASK],
        "privileged": [TASK],
    }
    return Policy(network, scales, dataset.names, options.chunk, about)


def _loss(network: Network, x: Array, y: Array) -> float:
    """Mean absolute error in units of each output's standard deviation."""
    return float(np.mean(np.abs(network(x) - y)))


def main(words: Sequence[str] | None = None) -> int:
    """Entry point: 0 done, 2 for a dataset that cannot be used."""

    def make(folder: Path, given: dict[str, Any], show: Progress) -> Policy:
        return train(read(folder), Options(**given), show)

    return command_line("train_bgr", (__doc__ or "").split("\n")[0], make, words)


if __name__ == "__main__":
    sys.exit(main())
