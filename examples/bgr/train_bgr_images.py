"""Trains the policy of `bgr_image_policy.py` on a LeRobot dataset (v2.1) with pictures.

    python3 examples/bgr/train_bgr_images.py datasets/bgr --out weights.npz --seed 0

As `train_bgr.py`, with small convolutions in front, in plain numpy: the same dataset, options and
seed give the same weights. It reads `observation.state`, `action` and the left endoscope's video
(PyAV), and nothing of the simulator's truth.
"""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from bgr_image_policy import (
    CHANNELS,
    CONVOLUTIONS,
    EARLIER,
    HERE,
    NUMBERS,
    PICTURE,
    ImageNetwork,
    ImagePolicy,
    grid,
    numbers,
    patches,
    places,
    shares,
    small,
    stacked,
)
from bgr_policy import ACTION, SET, STATE, state_columns
from bgr_training import (
    Adam,
    Array,
    Dataset,
    Progress,
    activations,
    command_line,
    facts,
    file_of,
    flat_layers,
    flat_names,
    huber,
    last_commands,
    propagate,
    split_episodes,
    table,
    targets_of,
)

OPEN = 0.6
"""Jaws that are more open hold nothing [rad]."""


@dataclass(frozen=True)
class Options:
    """What may be chosen; chosen with tuning seeds."""

    chunk: int = 16
    """Actions predicted at once."""
    ahead: tuple[int, ...] = (24, 32, 48, 64)
    """Steps of actions that are predicted, too: where all this leads to is learned from them."""
    maps: tuple[int, ...] = (32, 32, 32)
    """Of each convolution."""
    hidden: tuple[int, ...] = (256, 256)
    steps: int = 0
    """Of the optimiser; 0: so many that every sample comes ``passes`` times."""
    passes: int = 18
    batch: int = 64
    rate: float = 1e-3
    """Of learning, at first; falls to nothing along half a cosine."""
    decay: float = 1e-3
    """Of weights."""
    noise: float = 0.02
    """Added to normalised numbers."""
    push: float = 0.003
    """Spread of what every second command of open jaws is moved aside by, per axis [m],"""
    back: float = 0.25
    """and time constant of the way back [s]: what is seen says where to go, not what was said."""
    seed: int = 0


@dataclass
class Episode:
    """One recording of the dataset: T steps."""

    state: Array
    action: Array
    views: Array
    """(T, SIDE, SIDE, 3), uint8, of `small`."""


def read(folder: Path, progress: Progress = lambda part, note: None) -> Dataset[Episode]:
    """Read the tables and the videos of a dataset.

    Raises:
        ValueError: It is none, or lacks a feature that is needed.
    """
    needed = (STATE, ACTION)
    info = facts(folder, (*needed, PICTURE))
    names = {name: flat_names(info["features"][name]["names"]) for name in needed}
    episodes: dict[str, list[Episode]] = {}
    found = list(split_episodes(info))
    for n, (split, index) in enumerate(found):
        progress(0.2 * n / len(found), f"pictures of episode {n + 1} of {len(found)}")
        state, action = table(folder, info, index, needed)
        views = views_of(file_of(folder, info, "video_path", index, video_key=PICTURE))
        if len(views) != len(state):
            raise ValueError(
                f"{folder}: episode {index} has {len(views)} pictures and {len(state)} rows"
            )
        episodes.setdefault(split, []).append(Episode(state, action, views))
    shape = info["features"][PICTURE]["shape"]
    about = {"fps": info["fps"], "robot": info["robot_type"], "picture": shape}
    return Dataset(episodes, names, about)


def views_of(file: Path) -> Array:
    """All pictures of a video as `small` makes them.

    Raises:
        ValueError: It cannot be read.
    """
    try:
        import av
    except ImportError:
        raise ValueError("PyAV reads the videos: apt install python3-av") from None
    try:
        with av.open(str(file)) as container:
            shown = container.decode(video=0)
            return np.stack([small(frame.to_ndarray(format="rgb24")) for frame in shown])
    except (av.error.FFmpegError, IndexError) as problem:
        raise ValueError(f"{file}: no readable video ({problem})") from None


@dataclass
class Samples:
    """Steps to learn from, N in all; SI.

    Attributes:
        views: (N, SIDE, SIDE, 3), uint8.
        before: (N, len(EARLIER)) rows of the earlier views.
        numbers: (N, NUMBERS) of `numbers`.
        targets: (N, outputs, 5), relative to the last command but for the jaw.
        free: (N,) whether the jaws are open: nothing is held.
    """

    views: Array
    before: Array
    numbers: Array
    targets: Array
    free: Array

    @classmethod
    def of(cls, episodes: Sequence[Episode], columns: Array, options: Options) -> Samples:
        """The steps of episodes, one after another."""
        parts, begin = [], 0
        outputs = [*range(options.chunk), *options.ahead]
        for episode in episodes:
            row = np.arange(len(episode.state))
            last = last_commands(episode, columns[SET])
            before = [begin + np.maximum(row - lag, 0) for lag in EARLIER]
            parts.append(
                (
                    episode.views,
                    np.column_stack(before),
                    numbers(columns, episode.state, last),
                    targets_of(episode, last, max(outputs) + 1)[:, outputs],
                    episode.state[:, columns[4]] > OPEN,
                )
            )
            begin += len(row)
        return cls(*(np.concatenate(part) for part in zip(*parts, strict=True)))

    def pictures(self, rows: Array) -> Array:
        """What the network sees at some steps, of `stacked`."""
        return stacked(self.views[rows], [self.views[b] for b in self.before[rows].T])

    def pushed(self, rows: Array, push: Array, left: Array) -> tuple[Array, Array]:
        """Some steps as they would be, had the last command been another.

        Args:
            rows: (B,) of the samples.
            push: (B, 3) by how much it is aside [m]; where something is held, it is not.
            left: (outputs,) share of it that is left at each step.

        Returns:
            Numbers (B, NUMBERS) and targets (B, outputs, 5).
        """
        x, y = self.numbers[rows], self.targets[rows]
        push = push * self.free[rows][:, None]
        x[:, :3] -= push
        x[:, HERE][:, :3] += push
        y[:, :, :3] += push[:, None, :] * (left - 1.0)[:, None]
        return x, y


def shapes_of(options: Options) -> list[tuple[int, int]]:
    """Inputs and outputs of every layer."""
    found, channels = [], CHANNELS
    for (size, _, _), maps in zip(CONVOLUTIONS, options.maps, strict=True):
        found.append((size * size * channels, maps))
        channels = maps
    outputs = 5 * (options.chunk + len(options.ahead))
    return found + list(itertools.pairwise([3 * channels + NUMBERS, *options.hidden, outputs]))


def gradient_of(
    network: ImageNetwork,
    grads: Sequence[tuple[Array, Array]],
    pictures: Array,
    numbers: Array,
    target: Array,
) -> float:
    """Mean Huber loss of a batch; its gradient is written into ``grads``.

    Args:
        network: Its layers are read.
        grads: Of each layer, weight and bias; written.
        pictures: (B, SIDE, SIDE, CHANNELS) of `stacked`.
        numbers: (B, NUMBERS), normalised.
        target: (B, n_out), normalised.
    """
    taken, maps = [], [pictures]
    for i, ((weight, bias), shape) in enumerate(
        zip(network.convolutions, CONVOLUTIONS, strict=True)
    ):
        taken.append(patches(maps[-1], *shape))
        made = taken[-1] @ weight + bias
        maps.append(np.maximum(made, 0.0) if i < len(CONVOLUTIONS) - 1 else made)
    share = shares(maps[-1])
    seen = places(maps[-1], share)
    kept = activations(network.head, np.concatenate([seen, numbers], axis=1))
    loss, back = huber(kept.pop() - target)
    back = propagate(network.head, grads[len(CONVOLUTIONS) :], kept, back)
    slope = back @ network.head.layers[0][0][: seen.shape[1]].T
    slope = slope_of_places(maps[-1].shape, share, seen, slope)
    for i in range(len(CONVOLUTIONS) - 1, -1, -1):
        flat = slope.reshape(-1, slope.shape[3])
        np.matmul(taken[i].reshape(len(flat), -1).T, flat, out=grads[i][0])
        np.sum(flat, axis=0, out=grads[i][1])
        if i:
            slope = slope_of_patches(slope, network.convolutions[i][0], CONVOLUTIONS[i])
            slope *= maps[i] > 0
    return loss


def slope_of_places(shape: tuple[int, ...], share: Array, seen: Array, back: Array) -> Array:
    """Slope of the loss by maps, from that by their `places`.

    Args:
        shape: Of the maps.
        share: Of `shares`.
        seen: Of `places`.
        back: Slope by these, (B, 3 C).
    """
    B, h, w, C = shape
    down, right, means = np.split(back, 3, axis=1)
    where = np.matmul(grid(h, w, back.dtype), np.stack([down, right], axis=1))
    middle = seen[:, :C] * down + seen[:, C : 2 * C] * right
    found = share * (where - middle[:, None]) + means[:, None] / back.dtype.type(h * w)
    return found.reshape(B, h, w, C)


def slope_of_patches(back: Array, weight: Array, shape: tuple[int, int, int]) -> Array:
    """Slope of the loss by a convolution's inputs, from that by its outputs.

    A convolution, too, where patches are one apart: with the weights turned round.

    Args:
        back: (B, h, w, n_out).
        weight: (size * size * n_in, n_out).
        shape: One of `CONVOLUTIONS`.
    """
    size, stride, pad = shape
    assert stride == 1
    turned = weight.reshape(size, size, -1, weight.shape[1])[::-1, ::-1].transpose(0, 1, 3, 2)
    return patches(back, size, 1, size - 1 - pad) @ turned.reshape(-1, turned.shape[3])


def train(
    dataset: Dataset[Episode], options: Options, progress: Progress = lambda part, note: None
) -> ImagePolicy:
    """Train on the split ``train``.

    Raises:
        ValueError: There is nothing to train on.
    """
    columns = state_columns(dataset.names[STATE])
    if not dataset.episodes.get("train"):
        raise ValueError("the dataset has no episode in its split 'train'")
    parts = {
        split: Samples.of(episodes, columns, options)
        for split, episodes in dataset.episodes.items()
    }
    known = parts["train"]
    flat_targets = known.targets.reshape(len(known.targets), -1)
    scales = {
        "input_mean": known.numbers.mean(axis=0),
        "input_std": np.maximum(known.numbers.std(axis=0), 1e-3),
        "output_mean": flat_targets.mean(axis=0),
        "output_std": np.maximum(flat_targets.std(axis=0), 1e-4),
        "jaw_range": np.array([known.targets[:, :, 4].min(), known.targets[:, :, 4].max()]),
    }

    def normal(inputs: Array, targets: Array) -> tuple[Array, Array]:
        x = (inputs - scales["input_mean"]) / scales["input_std"]
        y = (targets.reshape(len(x), -1) - scales["output_mean"]) / scales["output_std"]
        return x.astype(np.float32), y.astype(np.float32)

    steps = options.steps or options.passes * math.ceil(len(known.numbers) / options.batch)
    rng = np.random.default_rng(options.seed)
    shapes = shapes_of(options)
    flat, layers = flat_layers(shapes)
    for weight, _ in layers:
        weight[:] = rng.standard_normal(weight.shape) * np.sqrt(2.0 / len(weight))
    layers[-1][0][:] *= 0.1
    network, adam = ImageNetwork(layers), Adam(flat, options.decay)
    slope, grads = flat_layers(shapes)
    steps_ahead = np.array([*range(options.chunk), *options.ahead]) + 1
    left = np.exp(-steps_ahead / (options.back * dataset.about["fps"]))
    for step in range(steps):
        rows = rng.integers(0, len(known.numbers), options.batch)
        push = options.push * rng.standard_normal((options.batch, 3))
        push[::2] = 0.0
        x, y = normal(*known.pushed(rows, push, left))
        x += options.noise * rng.standard_normal(x.shape, np.float32)
        loss = gradient_of(network, grads, known.pictures(rows), x, y)
        adam.step(slope, options.rate * 0.5 * (1 + np.cos(np.pi * step / steps)))
        if step % 50 == 0:
            note = f"step {step} of {steps}, loss {loss:.4f}"
            progress(0.2 + 0.8 * step / steps, note)
    about = {
        "options": asdict(options),
        "dataset": dataset.about,
        "episodes": {split: len(found) for split, found in dataset.episodes.items()},
        "frames": len(known.numbers),
        "parameters": int(flat.size),
        "network": "three convolutions and a multilayer perceptron",
        "loss": {
            split: _loss(network, part, *normal(part.numbers, part.targets))
            for split, part in parts.items()
        },
        "observation": [STATE, PICTURE],
        "privileged": [],
    }
    return ImagePolicy(network, scales, dataset.names, options.chunk, about)


def _loss(network: ImageNetwork, part: Samples, x: Array, y: Array) -> float:
    """Mean absolute error in units of each output's standard deviation; of every eighth step."""
    rows = np.arange(0, len(x), 8)
    made = [
        network(part.pictures(some), x[some])
        for some in np.array_split(rows, max(1, len(rows) // 64))
    ]
    return float(np.mean(np.abs(np.concatenate(made) - y[rows])))


def main(words: Sequence[str] | None = None) -> int:
    """Entry point: 0 done, 2 for a dataset that cannot be used."""

    def make(folder: Path, given: dict[str, Any], show: Progress) -> ImagePolicy:
        return train(read(folder, show), Options(**given), show)

    return command_line("train_bgr_images", (__doc__ or "").split("\n")[0], make, words)


if __name__ == "__main__":
    sys.exit(main())
