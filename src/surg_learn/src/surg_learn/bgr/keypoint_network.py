"""What one endoscope picture says about bowel grasping and retraction; numpy only.

A convolutional network finds points of the tissue and the instruments, each with an uncertainty.
`picture_memory` fuses what successive pictures say. `keypoint_training.py` trains the network.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from surg_learn.cloning.small_pictures import SIDE

Array = np.ndarray

CELLS = SIDE // 4
"""Side of a heat map."""
MAPS = ("helper", "tip")
"""Heat maps of points: the assistant's tip and the robot's own."""
CONVOLUTIONS = ((5, 2, 1), (3, 2, 1), (3, 1, 1), (3, 1, 2), (3, 1, 4), (3, 1, 1))
"""Patch size, stride and dilation of each convolution."""
HELD, OTHER_HELD, OTHER_JAW, TENSION = range(4)
"""Outputs of the perceptron: the chances that the robot and the assistant hold the bowel, the
assistant's jaw angle [rad], the tension [N]."""
AT, AXIS, PLACE, TIP, NEAR, SEEN = slice(4, 6), slice(6, 8), slice(8, 10), slice(10, 12), 12, 13
"""Further columns of the answer, all in the picture, down and right, -1 to 1 in the middle square:
the place on the bowel that the assistant would point at, the tube's direction there, the tips of
assistant and robot; how much of the tube is seen at that place, and how clearly the robot's tip is,
0 to 1."""
SAID = 14
WINDOWS = (2.5, 1.5)
"""Standard deviations of the windows in which the tube is looked for, in turn [cells]."""
OFF = 0.1
"""Standard deviation of the distance between the place that the assistant's tip alone tells and the
tube [half picture heights]."""
CLEAR = 0.08
"""Largest share of a cell in the map of a tip that is clearly seen."""


def scaled(views: Array) -> Array:
    """Input of the network from views (B, SIDE, SIDE, 3): float32, about -2 to 2."""
    return (views.astype(np.float32) - 128.0) / 64.0


def convolve(x: Array, weight: Array, bias: Array, stride: int, dilation: int) -> Array:
    """Convolution with zero padding that keeps the size, but for the stride.

    Args:
        x: (B, H, W, C).
        weight: (k, k, C, D).
        bias: (D,).
        stride: From one patch to the next.
        dilation: From one pixel of a patch to the next.

    Returns:
        (B, H / stride, W / stride, D).
    """
    B, H, W, C = x.shape
    k = weight.shape[0]
    pad = dilation * (k // 2)
    padded = np.zeros((B, H + 2 * pad, W + 2 * pad, C), x.dtype)
    padded[:, pad : pad + H, pad : pad + W] = x
    h, w = (H + stride - 1) // stride, (W + stride - 1) // stride
    parts = [
        padded[
            :,
            i * dilation : i * dilation + stride * (h - 1) + 1 : stride,
            j * dilation : j * dilation + stride * (w - 1) + 1 : stride,
        ]
        for i in range(k)
        for j in range(k)
    ]
    columns = np.concatenate(parts, axis=3).reshape(B * h * w, k * k * C)
    return (columns @ weight.reshape(k * k * C, -1) + bias).reshape(B, h, w, -1)


def grid(n: int) -> Array:
    """Coordinates of a map's n x n cells, -1 to 1, (n * n, 2): down, right."""
    line = np.linspace(-1, 1, n)
    down, right = np.meshgrid(line, line, indexing="ij")
    return np.column_stack([down.ravel(), right.ravel()]).astype(np.float32)


def shares(maps: Array) -> Array:
    """Spatial softmax of each map: (B, n, n, M) to (B, n * n, M)."""
    flat = maps.reshape(len(maps), -1, maps.shape[3])
    powers = np.exp(flat - flat.max(axis=1, keepdims=True))
    return powers / powers.sum(axis=1, keepdims=True)


def square(places: Array) -> Array:
    """Terms of a quadratic in places (N, 2): (N, 6)."""
    u, v = places[:, 0], places[:, 1]
    return np.column_stack([np.ones_like(u), u, v, u * u, u * v, v * v])


class Eye:
    """Convolutions, heat maps, and a multilayer perceptron over what is found; float32.

    A spatial softmax turns heat maps into coordinates finer than a cell (Levine et al. 2016). No
    point is regressed from the whole picture: a network that sees few scenes learns them by heart.

    Args:
        layers: Weights and biases: of `CONVOLUTIONS` (k, k, C, D), of the heat maps and of the map
            of the tube (C, M), of the three layers of the perceptron (n_in, n_out).
        pointed: (3, 2) from 1 and the place of an assistant's tip that points to the place of what
            it points at.
    """

    def __init__(self, layers: Sequence[tuple[Array, Array]], pointed: Array) -> None:
        self.layers, self.pointed = list(layers), pointed
        self.tube = np.zeros((CELLS, CELLS))
        """Where the newest view shows the tube, 0 to 1: for people who watch."""

    def __call__(self, views: Array) -> Array:
        """What views (B, SIDE, SIDE, 3), uint8, say: (B, SAID), see `HELD` to `SEEN`."""
        raw, where, clear, logits = self.network(views)
        said = raw.astype(np.float64)
        said[:, :2] = 1.0 / (1.0 + np.exp(-np.clip(said[:, :2], -9, 9)))
        tube = 1.0 / (1.0 + np.exp(-np.clip(logits, -9, 9)))
        self.tube = tube[-1]
        found = [self._find(*each) for each in zip(where[:, 0], tube, strict=True)]
        at, near = np.array([each[0] for each in found]), [each[1] for each in found]
        return np.column_stack([said, at, where.reshape(len(said), -1), near, clear])

    def network(self, views: Array) -> tuple[Array, Array, Array, Array]:
        """What was trained, float32.

        Args:
            views: (B, SIDE, SIDE, 3), uint8.

        Returns:
            Outputs of the perceptron (B, 4), places of `MAPS` (B, 2, 2), how clearly the robot's
            tip is seen (B,), logits of the tube (B, CELLS, CELLS).
        """
        n = len(CONVOLUTIONS)
        x = scaled(views)
        for (weight, bias), (_, stride, dilation) in zip(
            self.layers[:n], CONVOLUTIONS, strict=True
        ):
            x = np.maximum(convolve(x, weight, bias, stride, dilation), 0.0)
        weight, bias = self.layers[n]
        maps = x @ weight + bias
        share = shares(maps[..., : len(MAPS)])
        flat = x.reshape(len(x), -1, x.shape[3])
        where = np.matmul(share.transpose(0, 2, 1), grid(x.shape[1]))
        there = np.matmul(share.transpose(0, 2, 1), flat)
        y = np.concatenate(
            [where.reshape(len(x), -1), flat.mean(axis=1), there.reshape(len(x), -1)], axis=1
        )
        for weight, bias in self.layers[-3:-1]:
            y = np.maximum(y @ weight + bias, 0.0)
        weight, bias = self.layers[-1]
        clear = np.minimum(share[..., 1].max(axis=1) / CLEAR, 1.0)
        return y @ weight + bias, where, clear, maps[..., len(MAPS)]

    def _find(self, helper: Array, tube: Array) -> tuple[Array, float]:
        """Place and axis of the tube where the assistant would point, (4,), and `NEAR`.

        Args:
            helper: (2,) place of the assistant's tip.
            tube: (n, n) map of the tube.
        """
        cells = grid(len(tube)).astype(np.float64)
        cell = 2.0 / (len(tube) - 1)
        at = guess = np.append(1.0, helper) @ self.pointed
        for width in WINDOWS:
            window = np.exp(-0.5 * ((cells - at) ** 2).sum(axis=1) / (width * cell) ** 2)
            weight = window * tube.ravel()
            total = weight.sum() + 1e-9
            near = total / (window.sum() + 1e-9)
            if near < 0.02:
                break
            at = weight @ cells / total
        away = cells - at
        _, axes = np.linalg.eigh((away * weight[:, None]).T @ away / total)
        # The tube goes from right to left.
        axis = axes[:, 1] if axes[1, 1] < 0 else -axes[:, 1]
        near = min(near, 1.0) * np.exp(-0.5 * ((at - guess) @ (at - guess)) / OFF**2)
        return np.append(at, axis), float(near)
