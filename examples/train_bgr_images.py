"""Training of `bgr_image_policy.py` for `train_bgr.py --images`: same dataset, same optimiser."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from bgr_image_policy import (
    CONVOLUTIONS,
    FLAT,
    PICTURE,
    SIDE,
    ImageNetwork,
    ImagePolicy,
    square,
    windows,
)
from bgr_policy import ACTION, SET, STATE
from train_bgr import Adam, Array, Dataset, flat_layers, huber, targets_of

SHIFT = 3
"""Pictures are moved about by so many pixels at most while training."""


@dataclass(frozen=True)
class ImageOptions:
    """What may be chosen; chosen with tuning seeds."""

    chunk: int = 16
    hidden: tuple[int, ...] = (192, 192)
    steps: int = 2500
    batch: int = 128
    rate: float = 1e-3
    decay: float = 1e-4
    noise: float = 0.05
    """Added to the normalised state."""
    seed: int = 0


def sizes(options: ImageOptions, state: int) -> list[tuple[int, int]]:
    """Numbers in and out of every layer."""
    convolutions = [(k * k * c_in, c_out) for k, _, c_in, c_out in CONVOLUTIONS]
    full = [FLAT + state, *options.hidden, 5 * options.chunk]
    return [*convolutions, *itertools.pairwise(full)]


def pictures(folder: Path, index: int) -> Iterator[Array]:
    """Pictures of an episode as the policy sees them, in order."""
    import av

    info = json.loads((folder / "meta" / "info.json").read_text("utf-8"))
    if PICTURE not in info["features"]:
        raise ValueError(f"{folder}: the dataset has no {PICTURE}; record with --cameras")
    file = folder / info["video_path"].format(
        episode_chunk=index // info["chunks_size"], video_key=PICTURE, episode_index=index
    )
    with av.open(str(file)) as video:
        for frame in video.decode(video=0):
            yield square(frame.to_ndarray(format="rgb24"))


def forward(network: ImageNetwork, shown: Array, state: Array) -> tuple[list[Array], list[Array]]:
    """Inputs of every layer as matrices, and what each convolution gave as pictures."""
    x = shown.astype(np.float32) / np.float32(255.0) - np.float32(0.5)
    inputs, maps = [], []
    for (size, stride, _, _), (weight, bias) in zip(CONVOLUTIONS, network.layers, strict=False):
        seen = windows(x, size, stride)
        x = np.maximum(seen @ weight + bias, 0.0)
        inputs.append(seen.reshape(-1, seen.shape[-1]))
        maps.append(x)
    x = np.hstack([x.reshape(len(x), -1), state])
    for weight, bias in network.layers[len(CONVOLUTIONS) :]:
        inputs.append(x)
        x = np.maximum(x @ weight + bias, 0.0)
    weight, bias = network.layers[-1]
    return [*inputs, inputs[-1] @ weight + bias], maps


def gradient_of(
    network: ImageNetwork,
    grads: Sequence[tuple[Array, Array]],
    shown: Array,
    state: Array,
    target: Array,
) -> float:
    """Mean Huber loss of a batch; its gradient is written into ``grads``.

    Args:
        network: Its layers are read.
        grads: Of each layer, weight and bias; written.
        shown: (B, 96, 96, 3) uint8.
        state: (B, 9) float32, normalised.
        target: (B, n_out) float32, normalised.
    """
    inputs, maps = forward(network, shown, state)
    loss, back = huber(inputs.pop() - target)
    n = len(CONVOLUTIONS)
    for i in range(len(network.layers) - 1, n - 1, -1):
        np.matmul(inputs[i].T, back, out=grads[i][0])
        np.sum(back, axis=0, out=grads[i][1])
        back = back @ network.layers[i][0].T
        if i > n:
            back = back * (inputs[i] > 0)
    back = back[:, :FLAT].reshape(maps[-1].shape)
    for i in range(n - 1, -1, -1):
        back = back * (maps[i] > 0)
        rows = back.reshape(-1, back.shape[-1])
        np.matmul(inputs[i].T, rows, out=grads[i][0])
        np.sum(rows, axis=0, out=grads[i][1])
        if i:
            back = _spread(rows @ network.layers[i][0].T, back.shape, maps[i - 1].shape, i)
    return loss


def _spread(rows: Array, small: tuple[int, ...], large: tuple[int, ...], i: int) -> Array:
    """The opposite of `windows`: adds up what each place gave to the windows it is in."""
    size, stride, channels, _ = CONVOLUTIONS[i]
    count, height, width, _ = small
    parts = rows.reshape(count, height, width, size, size, channels)
    found = np.zeros(large, np.float32)
    for a in range(size):
        for b in range(size):
            rows_a = slice(a, a + stride * height, stride)
            found[:, rows_a, slice(b, b + stride * width, stride)] += parts[:, :, :, a, b]
    return found


def shifted(shown: Array, rng: np.random.Generator) -> Array:
    """Pictures (B, 96, 96, 3), each moved by a few pixels; the edge repeats."""
    around = ((0, 0), (SHIFT, SHIFT), (SHIFT, SHIFT), (0, 0))
    wide = np.pad(shown, around, mode="edge")
    down, right = rng.integers(0, 2 * SHIFT + 1, (2, len(shown)))
    cut = [
        wide[k, d : d + SIDE, r : r + SIDE]
        for k, (d, r) in enumerate(zip(down, right, strict=True))
    ]
    return np.stack(cut)


def train(
    dataset: Dataset,
    folder: Path,
    options: ImageOptions,
    progress: Callable[[float, str], None] = lambda part, note: None,
) -> ImagePolicy:
    """Train on the split ``train`` of the dataset in a folder.

    Raises:
        ValueError: There is nothing to train on, or there are no pictures.
    """
    shown, states, targets, index, splits = [], [], [], 0, {}
    everything = sum(len(found) for found in dataset.episodes.values())
    for split, episodes in dataset.episodes.items():
        first = sum(map(len, states))
        for episode in episodes:
            seen = np.stack(list(pictures(folder, index)))
            if len(seen) != len(episode.state):
                raise ValueError(f"{folder}: episode {index} has {len(seen)} pictures")
            shown.append(seen)
            states.append(episode.state)
            targets.append(targets_of(episode, SET, options.chunk).reshape(len(seen), -1))
            index += 1
            progress(0.2 * index / everything, f"pictures of {index} of {everything} episodes")
        splits[split] = (first, sum(map(len, states)))
    if "train" not in splits:
        raise ValueError("the dataset has no episode in its split 'train'")
    x, s, y = np.concatenate(shown), np.concatenate(states), np.concatenate(targets)
    chosen = slice(*splits["train"])
    scales = {
        "input_mean": s[chosen].mean(axis=0),
        "input_std": np.maximum(s[chosen].std(axis=0), 1e-3),
        "output_mean": y[chosen].mean(axis=0),
        "output_std": np.maximum(y[chosen].std(axis=0), 1e-4),
        "jaw_range": np.array([y[chosen, 4::5].min(), y[chosen, 4::5].max()]),
    }
    s = ((s - scales["input_mean"]) / scales["input_std"]).astype(np.float32)
    y = ((y - scales["output_mean"]) / scales["output_std"]).astype(np.float32)
    rng = np.random.default_rng(options.seed)
    shapes = sizes(options, s.shape[1])
    flat, layers = flat_layers(shapes)
    for weight, _ in layers:
        weight[:] = rng.standard_normal(weight.shape) * np.sqrt(2.0 / len(weight))
    layers[-1][0][:] *= 0.1
    network, adam = ImageNetwork(layers), Adam(flat, options.decay)
    slope, grads = flat_layers(shapes)
    first, last = splits["train"]
    for step in range(options.steps):
        rows = rng.integers(first, last, options.batch)
        noise = options.noise * rng.standard_normal((len(rows), s.shape[1]), np.float32)
        loss = gradient_of(network, grads, shifted(x[rows], rng), s[rows] + noise, y[rows])
        adam.step(slope, options.rate * 0.5 * (1 + np.cos(np.pi * step / options.steps)))
        if step % 10 == 0:
            part = 0.2 + 0.8 * step / options.steps
            progress(part, f"step {step} of {options.steps}, loss {loss:.4f}")
    losses = {}
    for split, (begin, end) in splits.items():
        rows = np.arange(begin, end)[:: max(1, (end - begin) // 1000)]
        found = [network(x[k : k + 1], s[k : k + 1]) for k in rows]
        losses[split] = float(np.mean(np.abs(np.concatenate(found) - y[rows])))
    about = {
        "options": asdict(options),
        "dataset": dataset.about,
        "episodes": {split: len(found) for split, found in dataset.episodes.items()},
        "frames": last - first,
        "parameters": int(flat.size),
        "loss": losses,
        "observation": [STATE, PICTURE],
        "privileged": [],
    }
    names = {STATE: dataset.names[STATE], ACTION: dataset.names[ACTION]}
    return ImagePolicy(network, scales, names, options.chunk, about)
