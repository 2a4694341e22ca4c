"""Trains the policy of `bgr_policy.py` on a LeRobot dataset (v2.1) of `./surg export`.

    python3 examples/bgr/train_bgr.py datasets/bgr --out weights.npz --seed 0

Behaviour cloning of action chunks with a small multilayer perceptron, in plain numpy: the same
dataset, options and seed give the same weights. It trains on the split `train` and prints the
losses on `train` and `val`.
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
    FORCE,
    HERE,
    PLACES,
    SET,
    STATE,
    TASK,
    TENSION,
    Columns,
    Network,
    Policy,
    features,
    force_columns,
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
    half_cosine,
    initialise,
    jaw_range,
    last_commands,
    mean_error,
    normalised,
    scales_of,
    split_episodes,
    table,
    targets_of,
    world_of,
)

OPEN, NEAR = 0.6, 0.03
"""Jaws less open than this [rad] and nearer to the requested node than this [m] will grasp."""
THERE = 0.0015
"""Jaws may close within this distance of their target [m]."""


@dataclass(frozen=True)
class Options:
    """Training options; their values were chosen on tuning seeds."""

    chunk: int = 16
    """Actions predicted at once."""
    hidden: tuple[int, ...] = (256, 256)
    steps: int = 5000
    """Optimiser steps."""
    batch: int = 256
    rate: float = 1.5e-3
    """Initial learning rate; falls to zero along half a cosine."""
    decay: float = 1e-4
    """Weight decay."""
    noise: float = 0.02
    """Standard deviation of the noise on normalised inputs."""
    noise_place: float = 0.3
    """The same for the last command, so that the policy does not depend on absolute position."""
    push: float = 0.004
    """Standard deviation of the offset of every second sample without a grasp, per axis [m]."""
    back: float = 0.25
    """Time constant of the return from that offset [s]."""
    forces: bool = False
    """Read `observation.force`, too."""
    tension: bool = True
    """Read the tissue's tension in the simulator's truth."""
    behind: int = 2
    """Largest lag of the observation behind the last command [steps], as in real time."""
    seed: int = 0


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
            columns[3] = columns[3][:, force_columns(names[FORCE])]
        episodes.setdefault(split, []).append(Episode(*columns))
    return Dataset(episodes, names, {"fps": info["fps"], "robot": info["robot_type"]})


@dataclass
class Samples:
    """N training steps; SI.

    Attributes:
        inputs: (N, F) of `features`.
        targets: (N, K, 5) of `targets_of`.
        free: (N,) whether the arm may be displaced: it holds nothing and is not about to grasp.
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
        """The steps of all episodes, in order.

        Args:
            episodes: Of the dataset.
            columns: Of the observations.
            X_RW: (4, 4) pose of the world in the rcm frame.
            chunk: Actions ahead.
            behind: Each step appears with its own observation and with each of the ``behind``
                earlier ones. Last command and target are those of the step itself.
        """
        parts = []
        for episode in episodes:
            last = last_commands(episode, columns.state[SET])
            targets = targets_of(episode, last, chunk)
            for steps in range(behind + 1):
                row = np.maximum(np.arange(len(last)) - steps, 0)
                state, task = episode.state[row], episode.task[row]
                felt = None if episode.force is None else episode.force[row]
                inputs = features(columns, state, task, last, X_RW, felt)
                held = task[:, columns.task["held"]] >= 0
                jaw = state[:, columns.state[4]]
                free = ~held & ((jaw > OPEN) | (inputs[:, DISTANCE] > NEAR))
                parts.append((inputs, targets, free, jaw))
        return cls(*(np.concatenate(part) for part in zip(*parts, strict=True)))

    def scales(self, tension: bool) -> dict[str, Array]:
        """Scales of inputs and targets, and range of the jaw; without tension, it is hidden."""
        found = scales_of(self.inputs, self.targets) | {"jaw_range": jaw_range(self.targets)}
        if not tension:
            found["input_std"][TENSION] = np.inf
        return found

    def pushed(self, rows: Array, push: Array, left: Array) -> tuple[Array, Array]:
        """Steps with the arm displaced, and the chunk that returns.

        A free arm follows its commands, so the correct chunk is known: it closes the gap. The jaws
        do not close before.

        Args:
            rows: (B,) indices of samples.
            push: (B, 3) displacement [m].
            left: (K,) remaining share of it at each step of the chunk.

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
        ValueError: The split is empty.
    """
    columns = Columns(dataset.names[STATE], dataset.names[TASK])
    shown = dataset.episodes.get("train")
    if not shown:
        raise ValueError("the dataset has no episode in its split 'train'")
    X_RW = world_of(shown, columns)
    parts = {
        split: Samples.of(episodes, columns, X_RW, options.chunk, options.behind)
        for split, episodes in dataset.episodes.items()
    }
    known = parts["train"]
    scales = known.scales(options.tension) | {"X_RW": X_RW}
    rng = np.random.default_rng(options.seed)
    sizes = [known.inputs.shape[1], *options.hidden, 5 * options.chunk]
    shapes = list(itertools.pairwise(sizes))
    flat, layers = flat_layers(shapes)
    initialise(layers, rng)
    network, adam = Network(layers), Adam(flat, options.decay)
    slope, grads = flat_layers(shapes)
    noise = np.full(sizes[0], options.noise, np.float32)
    noise[HERE] = options.noise_place
    left = np.exp(-np.arange(1, options.chunk + 1) / (options.back * dataset.about["fps"]))
    for step in range(options.steps):
        rows = rng.integers(0, len(known.inputs), options.batch)
        push = options.push * rng.standard_normal((options.batch, 3))
        push[::2] = 0.0
        x, y = normalised(scales, *known.pushed(rows, push, left))
        x += noise * rng.standard_normal(x.shape, np.float32)
        loss = gradient_of(network, grads, x, y)
        adam.step(slope, options.rate * half_cosine(step / options.steps))
        if step % 50 == 0:
            progress(step / options.steps, f"step {step} of {options.steps}, loss {loss:.4f}")
    losses = {
        split: mean_error(network, *normalised(scales, part.inputs, part.targets))
        for split, part in parts.items()
    }
    about = {
        "options": asdict(options),
        "dataset": dataset.about,
        "episodes": {split: len(found) for split, found in dataset.episodes.items()},
        "frames": sum(len(episode.state) for episode in shown),
        "parameters": int(flat.size),
        "loss": losses,
        "observation": [STATE, TASK, *([FORCE] if options.forces else [])],
        "privileged": [TASK],
    }
    return Policy(network, scales, dataset.names, options.chunk, about)


def main(words: Sequence[str] | None = None) -> int:
    """Entry point; returns 0, or 2 for an unusable dataset."""

    def make(folder: Path, given: dict[str, Any], show: Progress) -> Policy:
        options = Options(**given)
        return train(read(folder, options.forces), options, show)

    return command_line("train_bgr", (__doc__ or "").split("\n")[0], make, words, forces=True)


if __name__ == "__main__":
    sys.exit(main())
