"""A multilayer perceptron and its optimiser, in plain numpy; for `action_head.py`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from surg_learn.cloning.chunk_policy import Network

Array = np.ndarray


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


def gradient_of(
    network: Network, grads: Sequence[tuple[Array, Array]], x: Array, target: Array
) -> float:
    """Mean Huber loss (linear above 0.5) of a batch; writes the gradient into ``grads``.

    Args:
        network: Read only.
        grads: Weight and bias of each layer; written.
        x: (B, n_in), normalised.
        target: (B, n_out), normalised.
    """
    kept = [x]  # inputs of every layer
    for weight, bias in network.layers[:-1]:
        kept.append(np.maximum(kept[-1] @ weight + bias, 0.0))
    weight, bias = network.layers[-1]
    error = kept[-1] @ weight + bias - target
    bounded = np.clip(error, -0.5, 0.5)
    loss = float(np.mean(bounded * (error - 0.5 * bounded)))
    back = bounded / error.dtype.type(error.size)
    for i in range(len(network.layers) - 1, -1, -1):
        np.matmul(kept[i].T, back, out=grads[i][0])
        np.sum(back, axis=0, out=grads[i][1])
        if i:
            back = (back @ network.layers[i][0].T) * (kept[i] > 0)
    return loss


def flat_layers(shapes: Sequence[tuple[int, int]]) -> tuple[Array, list[tuple[Array, Array]]]:
    """One vector of zeros, and weights (n_in, n_out) and biases as views into it."""
    flat, layers, at = np.zeros(sum((a + 1) * b for a, b in shapes), np.float32), [], 0
    for a, b in shapes:
        weight = flat[at : at + a * b].reshape(a, b)
        layers.append((weight, flat[at + a * b : at + (a + 1) * b]))
        at += (a + 1) * b
    return flat, layers


def initialise(layers: Sequence[tuple[Array, Array]], rng: np.random.Generator) -> None:
    """Draw the weights after He et al. (2015); the last layer starts small."""
    for weight, _ in layers:
        weight[:] = rng.standard_normal(weight.shape) * np.sqrt(2.0 / len(weight))
    layers[-1][0][:] *= 0.1


def mean_error(network: Network, x: Array, y: Array) -> float:
    """Mean absolute error in units of each output's standard deviation."""
    return float(np.mean(np.abs(network(x) - y)))


def size_of(network: Any) -> int:
    """Number of weights and biases of a network with `layers`."""
    return int(sum(weight.size + bias.size for weight, bias in network.layers))
