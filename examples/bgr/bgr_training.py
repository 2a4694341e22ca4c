"""Shared by the trainers of the learned policies: dataset files, perceptron, optimiser.

Used by `train_bgr.py` and `train_bgr_images.py`; plain numpy.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from bgr_policy import Columns, Network, Policy, world_in_rcm

Array = np.ndarray
Progress = Callable[[float, str], None]
"""Called with the finished share, 0 to 1, and a note."""
RATE = 20
"""Of the steps that a policy answers with [Hz]."""
E = TypeVar("E")
"""One recording, in a trainer's own type."""


# --- a LeRobot dataset (v2.1) ---------------------------------------------------------------------


@dataclass
class Dataset(Generic[E]):
    """Episodes by split, and the column names of each feature."""

    episodes: dict[str, list[E]]
    names: dict[str, list[str]]
    about: dict[str, Any]


def facts(folder: Path, needed: Sequence[str]) -> dict[str, Any]:
    """Metadata of a dataset (`meta/info.json`).

    Args:
        folder: Of the dataset.
        needed: Required features.

    Raises:
        ValueError: The folder is no dataset of version 2, a feature is missing, the actions are not
            absolute, or the rate is another than the policies'.
    """
    try:
        info: dict[str, Any] = json.loads((folder / "meta" / "info.json").read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise ValueError(f"{folder}: no LeRobot dataset (meta/info.json: {error})") from None
    version = str(info.get("codebase_version", "v2"))
    if not version.startswith("v2"):
        raise ValueError(
            f"{folder}: a LeRobot dataset of version {version} (meta/info.json); allowed: v2.1. "
            "Export it again with --format lerobot"
        )
    missing = [name for name in needed if name not in info["features"]]
    if missing:
        raise ValueError(
            f"{folder}: the dataset has no {', '.join(missing)}; export it without --drop"
        )
    space = info.get("action_space", "absolute")
    if space != "absolute":
        raise ValueError(
            f"{folder}: its action space is {space!r} (meta/info.json); allowed: 'absolute'. "
            "Export it again without --action-space"
        )
    check_rate(folder, info.get("fps", 0))
    return info


def check_rate(folder: Path, fps: float) -> None:
    """Refuse a dataset whose steps are longer or shorter than those that policies are asked for.

    Raises:
        ValueError: It is.
    """
    if fps != RATE:
        raise ValueError(
            f"{folder}: its steps come at {fps:g} Hz; allowed: {RATE}, at which a policy acts. "
            "Export it again without --fps"
        )


def split_episodes(info: dict[str, Any]) -> Iterator[tuple[str, int]]:
    """Split and index of every episode."""
    for split, ends in info["splits"].items():
        first, last = (int(number) for number in ends.split(":"))
        for index in range(first, last):
            yield split, index


def file_of(folder: Path, info: dict[str, Any], path: str, index: int, **more: str) -> Path:
    """A file of an episode.

    Args:
        folder: Of the dataset.
        info: Of `facts`.
        path: Key of the path pattern, such as ``data_path``.
        index: Of the episode.
        **more: Further fields of the pattern.
    """
    chunk = index // info["chunks_size"]
    name: str = info[path].format(episode_chunk=chunk, episode_index=index, **more)
    return folder / name


def table(folder: Path, info: dict[str, Any], index: int, names: Sequence[str]) -> list[Array]:
    """Arrays of an episode by feature, each (T, n)."""
    import pyarrow.parquet

    file = file_of(folder, info, "data_path", index)
    found = pyarrow.parquet.read_table(file, columns=list(names))
    return [np.stack(found[name].to_numpy()).astype(np.float64) for name in names]


def flat_names(names: Any) -> list[str]:
    """Column names of a feature; the format allows a list, or a dictionary with one."""
    return list(next(iter(names.values()))) if isinstance(names, dict) else list(names)


# --- targets --------------------------------------------------------------------------------------


class Steps(Protocol):
    """The arrays of an episode of T steps that the targets need."""

    state: Array
    action: Array


class Told(Steps, Protocol):
    """An episode with the simulator's truth."""

    task: Array


def world_of(episodes: Sequence[Told], columns: Columns) -> Array:
    """X_RW (4, 4) from the tips of all episodes, see `world_in_rcm`."""
    tips = [episode.state[:, columns.state[:3]] for episode in episodes]
    tips_W = [episode.task[:, columns.task["tip"]] for episode in episodes]
    return world_in_rcm(np.concatenate(tips), np.concatenate(tips_W))


def mean_error(network: Network, x: Array, y: Array) -> float:
    """Mean absolute error in units of each output's standard deviation."""
    return float(np.mean(np.abs(network(x) - y)))


def last_commands(episode: Steps, held: Any) -> Array:
    """Tip and roll of the last command at each step, (T, 4); at the first step, the set-point.

    Args:
        episode: Of the dataset.
        held: Columns of the state with the set-point of tip and roll.
    """
    return np.vstack([episode.state[:1, held], episode.action[:-1, :4]])


def targets_of(episode: Steps, last: Array, chunk: int) -> Array:
    """Targets of the prediction at each step, (T, chunk, 5).

    They are relative to the last command, except for the jaw. After the end the last action holds.

    Args:
        episode: Of the dataset.
        last: (T, 4) of `last_commands`.
        chunk: Actions ahead.
    """
    row = np.arange(len(episode.state))
    ahead = np.minimum(row[:, None] + np.arange(chunk), len(row) - 1)
    targets = episode.action[ahead]
    targets[:, :, :4] -= last[:, None, :]
    return targets


# --- optimiser and perceptron ---------------------------------------------------------------------


class Adam:
    """The optimiser of Kingma and Ba (2015) with decoupled weight decay, on one flat vector.

    Args:
        parameters: (n,) float32; changed in place.
        decay: Weight decay, multiplied by the learning rate.
    """

    def __init__(self, parameters: Array, decay: float) -> None:
        self._p, self._decay, self._t = parameters, decay, 0
        self._m, self._v = np.zeros_like(parameters), np.zeros_like(parameters)
        self._buffer = np.empty_like(parameters)

    def step(self, gradient: Array, rate: float) -> None:
        """Take one step."""
        self._t += 1
        b1, b2, buffer = 0.9, 0.999, self._buffer
        self._m *= b1
        self._m += np.multiply(gradient, 1 - b1, out=buffer)
        np.multiply(gradient, gradient, out=buffer)
        buffer *= 1 - b2
        self._v *= b2
        self._v += buffer
        np.divide(self._v, 1 - b2**self._t, out=buffer)
        np.sqrt(buffer, out=buffer)
        buffer += 1e-8
        np.divide(self._m, buffer, out=buffer)
        buffer *= rate / (1 - b1**self._t)
        self._p *= 1 - rate * self._decay
        self._p -= buffer


def huber(error: Array) -> tuple[float, Array]:
    """Mean Huber loss (linear above 0.5) of errors, and its derivative by each error."""
    bounded = np.clip(error, -0.5, 0.5)
    loss = float(np.mean(bounded * (error - 0.5 * bounded)))
    return loss, bounded / error.dtype.type(error.size)


def gradient_of(
    network: Network, grads: Sequence[tuple[Array, Array]], x: Array, target: Array
) -> float:
    """Mean Huber loss of a batch; writes the gradient into ``grads``.

    Args:
        network: Read only.
        grads: Weight and bias of each layer; written.
        x: (B, n_in), normalised.
        target: (B, n_out), normalised.
    """
    kept = activations(network, x)
    loss, back = huber(kept.pop() - target)
    propagate(network, grads, kept, back)
    return loss


def activations(network: Network, x: Array) -> list[Array]:
    """Inputs of every layer, then the outputs."""
    kept = [x]
    for weight, bias in network.layers[:-1]:
        kept.append(np.maximum(kept[-1] @ weight + bias, 0.0))
    weight, bias = network.layers[-1]
    return [*kept, kept[-1] @ weight + bias]


def propagate(
    network: Network, grads: Sequence[tuple[Array, Array]], kept: Sequence[Array], back: Array
) -> Array:
    """Write the gradient of all layers.

    Args:
        network: Read only.
        grads: Weight and bias of each layer; written.
        kept: Inputs of each layer.
        back: Derivative of the loss by the outputs.

    Returns:
        Derivative by the first layer's outputs, before its ReLU.
    """
    for i in range(len(network.layers) - 1, -1, -1):
        np.matmul(kept[i].T, back, out=grads[i][0])
        np.sum(back, axis=0, out=grads[i][1])
        if i:
            back = (back @ network.layers[i][0].T) * (kept[i] > 0)
    return back


def flat_layers(shapes: Sequence[tuple[int, int]]) -> tuple[Array, list[tuple[Array, Array]]]:
    """One vector of zeros, and weights (n_in, n_out) and biases as views into it."""
    flat, layers, at = np.zeros(sum((a + 1) * b for a, b in shapes), np.float32), [], 0
    for a, b in shapes:
        weight = flat[at : at + a * b].reshape(a, b)
        layers.append((weight, flat[at + a * b : at + (a + 1) * b]))
        at += (a + 1) * b
    return flat, layers


def scales_of(inputs: Array, targets: Array) -> dict[str, Array]:
    """Mean and standard deviation of inputs (N, F) and flat targets (N, K * 5)."""
    flat = targets.reshape(len(targets), -1)
    return {
        "input_mean": inputs.mean(axis=0),
        "input_std": np.maximum(inputs.std(axis=0), 1e-3),
        "output_mean": flat.mean(axis=0),
        "output_std": np.maximum(flat.std(axis=0), 1e-4),
    }


def jaw_range(targets: Array) -> Array:
    """Smallest and largest jaw angle of targets (N, K, 5)."""
    return np.array([targets[:, :, 4].min(), targets[:, :, 4].max()])


def normalised(scales: Mapping[str, Array], inputs: Array, targets: Array) -> tuple[Array, Array]:
    """Inputs (N, F) and flat targets (N, K * 5) with mean 0 and standard deviation 1, float32."""
    x = (inputs - scales["input_mean"]) / scales["input_std"]
    y = (targets.reshape(len(x), -1) - scales["output_mean"]) / scales["output_std"]
    return x.astype(np.float32), y.astype(np.float32)


def initialise(layers: Sequence[tuple[Array, Array]], rng: np.random.Generator) -> None:
    """Draw the weights after He et al. (2015); the last layer starts small."""
    for weight, _ in layers:
        weight[:] = rng.standard_normal(weight.shape) * np.sqrt(2.0 / len(weight))
    layers[-1][0][:] *= 0.1


def half_cosine(part: float) -> float:
    """Factor of the learning rate after a share of the training: from 1 to 0."""
    return 0.5 * (1 + np.cos(np.pi * part))


# --- the command line -----------------------------------------------------------------------------


def command_line(
    name: str,
    help_text: str,
    make: Callable[[Path, dict[str, Any], Progress], Policy],
    words: Sequence[str] | None,
    forces: bool = False,
    devices: Sequence[str] = (),
    labels: Sequence[str] = (),
) -> int:
    """Command line of a trainer.

    Args:
        name: Of the program.
        help_text: One line.
        make: Trains; takes the dataset's folder, the given options and the progress callback.
        words: Of the command line.
        forces: Whether there are options `--forces` and `--no-tension`.
        devices: Values of an option `--device`, the default first; empty: there is none.
        labels: Values of an option `--labels`, likewise.

    Returns:
        Exit status: 0 done, 2 for an unusable dataset.
    """
    options = _parser(name, help_text, forces, devices, labels).parse_args(words)
    started = time.monotonic()

    def show(part: float, note: str) -> None:
        print(json.dumps({"part": part, "note": note}) if options.json else note, flush=True)

    given = {
        n: getattr(options, n)
        for n in ("seed", "steps", "chunk")
        if getattr(options, n) is not None
    }
    given |= {"forces": options.forces, "tension": options.tension} if forces else {}
    given |= {"device": options.device} if devices else {}
    given |= {"labels": options.labels} if labels else {}
    try:
        policy = make(options.dataset, given, show)
    except ValueError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return 2
    options.out.parent.mkdir(parents=True, exist_ok=True)
    policy.save(options.out)
    known = policy.about
    losses = ", ".join(f"{split} {value:.4f}" for split, value in known["loss"].items())
    kind = known.get("network", "multilayer perceptron")
    words = (
        f"chunks of {policy.chunk}, {kind}, {known['parameters']} parameters, "
        f"{known['frames']} frames, loss {losses}"
    )
    told = {**known, "words": words, "weights": policy.hash, "s": time.monotonic() - started}
    print(json.dumps(told) if options.json else f"{words}; weights {policy.hash[:16]}", flush=True)
    return 0


def _parser(
    name: str, help_text: str, forces: bool, devices: Sequence[str], labels: Sequence[str]
) -> argparse.ArgumentParser:
    """See `command_line`."""
    parser = argparse.ArgumentParser(prog=name, description=help_text)
    parser.add_argument("dataset", type=Path, help="folder written by ./surg export")
    parser.add_argument("--out", type=Path, required=True, help="file for the weights (.npz)")
    parser.add_argument("--seed", type=int, help="seed of the training (default 0)")
    parser.add_argument("--steps", type=int, help="optimiser steps")
    parser.add_argument("--chunk", type=int, help="actions predicted at once")
    if forces:
        parser.add_argument("--forces", action="store_true", help="read observation.force, too")
        no_tension = "do not read the tissue's tension, which no robot measures"
        parser.add_argument("--no-tension", dest="tension", action="store_false", help=no_tension)
    if devices:
        parser.add_argument("--device", choices=devices, default=devices[0], help="where it trains")
    if labels:
        which = (
            "what the eye learns from: the simulator's truth, or what people and robots can tell"
        )
        parser.add_argument("--labels", choices=labels, default=labels[0], help=which)
    parser.add_argument("--json", action="store_true", help="progress as JSON lines")
    return parser
