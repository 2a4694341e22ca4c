"""The hand of both policies: a perceptron trained on displaced and noisy samples; plain numpy.

Used by `train_state.py` and `train_images.py`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Protocol

import numpy as np

from surg_learn.bgr.observed_features import HERE, Columns
from surg_learn.bgr.training.perceptron import (
    Adam,
    flat_layers,
    gradient_of,
    initialise,
    mean_error,
)
from surg_learn.cloning.arm_columns import SET
from surg_learn.cloning.chunk_policy import Network
from surg_learn.cloning.training.lerobot_dataset import (
    Dataset,
    Progress,
    jaw_range,
    last_commands,
    normalised,
    scales_of,
    targets_of,
)
from surg_learn.cloning.training.trainer_options import half_cosine

Array = np.ndarray
OPEN, NEAR = 0.6, 0.03
"""Jaws less open than this [rad] and nearer to the requested node than this [m] will grasp."""
THERE = 0.0015
"""Jaws may close within this distance of their target [m]."""


@dataclass(frozen=True)
class HandOptions:
    """Training options of the hand; their values were chosen on tuning seeds."""

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
    behind: int = 2
    """Largest lag of the observation behind the last command [steps], as in real time."""
    seed: int = 0


Inputs = Callable[[Array, Array], Array]
"""Of rows (T,) of an episode and the last commands (T, 4) at its steps: the features (T, F)."""


class Recording(Protocol):
    """One recording of T steps."""

    state: Array
    task: Array
    action: Array


@dataclass
class Samples:
    """N training steps; SI.

    Attributes:
        inputs: (N, F) features. The first ``places`` are vectors from the last command, the next is
            the length of the first vector, the last three (`HERE`) are the last command.
        targets: (N, K, 5) of `targets_of`.
        free: (N,) of `may_move`.
        jaw: (N,) jaw angle [rad].
        places: Number of columns.
    """

    inputs: Array
    targets: Array
    free: Array
    jaw: Array
    places: int

    @classmethod
    def of(
        cls,
        episodes: Iterable[tuple[Recording, Inputs, Array]],
        columns: Columns,
        chunk: int,
        behind: int,
        places: int,
    ) -> Samples:
        """The steps of all episodes, in order.

        Args:
            episodes: Each with its inputs and with the steps (T,) that are taken.
            columns: Of the observations.
            chunk: Actions ahead.
            behind: Each step appears with its own observation and with each of the ``behind``
                earlier ones. Last command and target are those of the step itself.
            places: See the class.
        """
        parts = []
        for episode, inputs, good in episodes:
            last = last_commands(episode.state, episode.action, columns.state[SET])
            targets = targets_of(episode.action, last, chunk)
            for steps in range(behind + 1):
                row = np.maximum(np.arange(len(last)) - steps, 0)
                x = inputs(row, last)
                jaw = episode.state[row, columns.state[4]]
                held = episode.task[row][:, columns.task["held"]].ravel()
                free = may_move(held, jaw, x[:, places])
                parts.append((x[good], targets[good], free[good], jaw[good]))
        x, targets, free, jaw = (np.concatenate(part) for part in zip(*parts, strict=True))
        return cls(x, targets, free, jaw, places)

    def pushed(self, rows: Array, push: Array, left: Array) -> tuple[Array, Array]:
        """Steps with the arm displaced, and the chunk that returns.

        A free arm follows its commands, so the correct chunk is known: it closes the gap. The jaws
        do not close before. What an eye says of the tissue stays: it does not look for the arm.

        Args:
            rows: (B,) indices of samples.
            push: (B, 3) displacement [m].
            left: (K,) remaining share of it at each step of the chunk.

        Returns:
            Inputs (B, F) and targets (B, K, 5).
        """
        x, y, jaw = self.inputs[rows], self.targets[rows], self.jaw[rows][:, None]
        push = push * self.free[rows][:, None]
        x[:, : self.places] -= np.tile(push, self.places // 3)
        x[:, self.places] = np.linalg.norm(x[:, :3], axis=1)
        x[:, HERE] += push
        y[:, :, :3] += push[:, None, :] * (left - 1.0)[:, None]
        far = np.linalg.norm(push, axis=1)[:, None] * left > THERE
        y[:, :, 4] = np.where(far, np.maximum(y[:, :, 4], jaw), y[:, :, 4])
        return x, y


def may_move(held: Array, jaw: Array, distance: Array) -> Array:
    """Whether the arm may be displaced, (T,): it holds nothing and is not about to grasp.

    Args:
        held: (T,) node that the robot holds; negative: none.
        jaw: (T,) jaw angle [rad].
        distance: (T,) from the last command to the requested node [m].
    """
    return (held < 0) & ((jaw > OPEN) | (distance > NEAR))


def fit_hand(
    known: Samples,
    scales: Mapping[str, Array],
    options: HandOptions,
    fps: float,
    progress: Progress = lambda part, note: None,
) -> Network:
    """Train a hand.

    Args:
        known: Of the split ``train``.
        scales: Of `scales_of`.
        options: How.
        fps: Steps in a second.
        progress: Is told how far it is.
    """
    rng = np.random.default_rng(options.seed)
    sizes = [known.inputs.shape[1], *options.hidden, 5 * options.chunk]
    shapes = list(itertools.pairwise(sizes))
    flat, layers = flat_layers(shapes)
    initialise(layers, rng)
    network, adam = Network(layers), Adam(flat, options.decay)
    slope, grads = flat_layers(shapes)
    noise = np.full(sizes[0], options.noise, np.float32)
    noise[HERE] = options.noise_place
    left = np.exp(-np.arange(1, options.chunk + 1) / (options.back * fps))
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
    return network


def hand_of(
    parts: Mapping[str, Samples],
    dataset: Dataset[Any],
    options: HandOptions,
    progress: Progress = lambda part, note: None,
) -> tuple[Network, dict[str, Array], dict[str, Any]]:
    """Train a hand on the split ``train``; also returns its scales, and what is told of it.

    Args:
        parts: Samples of each split.
        dataset: That they are of.
        options: How.
        progress: Is told how far it is.
    """
    known = parts["train"]
    scales = {**scales_of(known.inputs, known.targets), "jaw_range": jaw_range(known.targets)}
    hand = fit_hand(known, scales, options, dataset.about["fps"], progress)
    about = {
        "options": asdict(options),
        "dataset": dataset.about,
        "episodes": {split: len(found) for split, found in dataset.episodes.items()},
        "frames": sum(len(episode.state) for episode in dataset.episodes["train"]),
        "loss": {
            split: mean_error(hand, *normalised(scales, part.inputs, part.targets))
            for split, part in parts.items()
        },
    }
    return hand, scales, about
