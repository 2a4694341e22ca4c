"""Trains the policy of `bgr_image_policy.py` on a LeRobot dataset (v2.1) with pictures.

    python3 examples/bgr/train_bgr_images.py datasets/bgr --out weights.npz --seed 0

Like `train_bgr.py`, with convolutions before the perceptron, in plain numpy: the same dataset,
options and seed give the same weights. It reads `observation.state`, `action` and the left
endoscope's video (PyAV), and no ground truth.
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
    half_cosine,
    huber,
    initialise,
    jaw_range,
    last_commands,
    normalised,
    propagate,
    scales_of,
    split_episodes,
    table,
    targets_of,
)

OPEN = 0.6
"""Jaws more open than this hold nothing [rad]."""


@dataclass(frozen=True)
class Options:
    """Training options; their values were chosen on tuning seeds."""

    chunk: int = 16
    """Actions predicted at once."""
    ahead: tuple[int, ...] = (24, 32, 48, 64)
    """Further steps whose actions are predicted during training only; they show the goal."""
    maps: tuple[int, ...] = (32, 32, 32)
    """Outputs of each convolution."""
    hidden: tuple[int, ...] = (256, 256)
    steps: int = 0
    """Optimiser steps; 0: enough for ``passes`` passes over all samples."""
    passes: int = 18
    batch: int = 64
    rate: float = 1e-3
    """Initial learning rate; falls to zero along half a cosine."""
    decay: float = 1e-3
    """Weight decay."""
    noise: float = 0.02
    """Standard deviation of the noise on normalised measured inputs."""
    push: float = 0.003
    """Standard deviation of the offset of every second command with open jaws, per axis [m]."""
    back: float = 0.25
    """Time constant of the return [s]: the goal comes from the picture, not from the command."""
    seed: int = 0


@dataclass
class Episode:
    """One recording of T steps."""

    state: Array
    action: Array
    views: Array
    """(T, SIDE, SIDE, 3), uint8, of `small`."""


def read(folder: Path, progress: Progress = lambda part, note: None) -> Dataset[Episode]:
    """Read the tables and the videos of a dataset.

    Raises:
        ValueError: The folder is no dataset, or a required feature is missing.
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
    """All pictures of a video, scaled by `small`.

    Raises:
        ValueError: The video cannot be read.
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
    """N training steps; SI.

    Attributes:
        views: (N, SIDE, SIDE, 3), uint8.
        before: (N, len(EARLIER)) indices of the earlier views.
        numbers: (N, NUMBERS) of `numbers`.
        targets: (N, outputs, 5), relative to the last command except for the jaw.
        free: (N,) whether the jaws are open and hold nothing.
    """

    views: Array
    before: Array
    numbers: Array
    targets: Array
    free: Array

    @classmethod
    def of(cls, episodes: Sequence[Episode], columns: Array, options: Options) -> Samples:
        """The steps of all episodes, in order."""
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
        """Pictures of samples as `stacked` returns them."""
        return stacked(self.views[rows], [self.views[b] for b in self.before[rows].T])

    def pushed(self, rows: Array, push: Array, left: Array) -> tuple[Array, Array]:
        """Steps with another last command, and the chunk that returns.

        Args:
            rows: (B,) indices of samples.
            push: (B, 3) displacement of the command [m]; ignored if the jaws may hold something.
            left: (outputs,) remaining share of it at each step.

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
    """Input and output size of every layer."""
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
    """Mean Huber loss of a batch; writes the gradient into ``grads``.

    Args:
        network: Read only.
        grads: Weight and bias of each layer; written.
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
    """Derivative of the loss by the maps, from that by their `places`.

    Args:
        shape: Of the maps.
        share: Of `shares`.
        seen: Of `places`.
        back: Derivative by the places, (B, 3 C).
    """
    B, h, w, C = shape
    down, right, means = np.split(back, 3, axis=1)
    where = np.matmul(grid(h, w, back.dtype), np.stack([down, right], axis=1))
    middle = seen[:, :C] * down + seen[:, C : 2 * C] * right
    found = share * (where - middle[:, None]) + means[:, None] / back.dtype.type(h * w)
    return found.reshape(B, h, w, C)


def slope_of_patches(back: Array, weight: Array, shape: tuple[int, int, int]) -> Array:
    """Derivative of the loss by a convolution's inputs, from that by its outputs.

    At stride 1 this is a convolution with the flipped weights.

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
        ValueError: The split is empty.
    """
    columns = state_columns(dataset.names[STATE])
    if not dataset.episodes.get("train"):
        raise ValueError("the dataset has no episode in its split 'train'")
    parts = {
        split: Samples.of(episodes, columns, options)
        for split, episodes in dataset.episodes.items()
    }
    known = parts["train"]
    scales = {
        **scales_of(known.numbers, known.targets),
        "jaw_range": jaw_range(known.targets),
    }
    steps = options.steps or options.passes * math.ceil(len(known.numbers) / options.batch)
    rng = np.random.default_rng(options.seed)
    shapes = shapes_of(options)
    flat, layers = flat_layers(shapes)
    initialise(layers, rng)
    network, adam = ImageNetwork(layers), Adam(flat, options.decay)
    slope, grads = flat_layers(shapes)
    steps_ahead = np.array([*range(options.chunk), *options.ahead]) + 1
    left = np.exp(-steps_ahead / (options.back * dataset.about["fps"]))
    for step in range(steps):
        rows = rng.integers(0, len(known.numbers), options.batch)
        push = options.push * rng.standard_normal((options.batch, 3))
        push[::2] = 0.0
        x, y = normalised(scales, *known.pushed(rows, push, left))
        x += options.noise * rng.standard_normal(x.shape, np.float32)
        loss = gradient_of(network, grads, known.pictures(rows), x, y)
        adam.step(slope, options.rate * half_cosine(step / steps))
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
            split: _loss(network, part, *normalised(scales, part.numbers, part.targets))
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
    """Entry point; returns 0, or 2 for an unusable dataset."""

    def make(folder: Path, given: dict[str, Any], show: Progress) -> ImagePolicy:
        return train(read(folder, show), Options(**given), show)

    return command_line("train_bgr_images", (__doc__ or "").split("\n")[0], make, words)


if __name__ == "__main__":
    sys.exit(main())
