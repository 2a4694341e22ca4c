"""A learned policy for bowel grasping and retraction from endoscope pictures; numpy only.

    python3 examples/bgr/bgr_image_policy.py --weights weights.npz --server tcp://127.0.0.1:5555

`train_bgr_images.py` writes the weights. The policy reads `observation.state` and the endoscope's
left picture: **what a robot can measure, and nothing else**. It answers each observation with a
chunk of actions for the next steps. `bgr_policy.py` does the same from ground truth.
"""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
from bgr_policy import SET, STATE, Network, Policy, serve, state_columns

PICTURE = "observation.images.endoscope.left"
SIDE = 96
"""Side of the input picture [px]."""
EARLIER = (20, 40)
"""Steps back of the earlier grey pictures, which show where the assistant pointed."""
CHANNELS = 3 + len(EARLIER)
JAW_LAGS = (4, 8, 16)
"""Steps back of the earlier jaw angles, which show how long the jaws have been closed."""
NUMBERS = 12
"""Columns of `numbers`."""
HERE = slice(8, 12)
"""Columns of `numbers` with the last command."""
CONVOLUTIONS = ((8, 4, 2), (3, 1, 1), (3, 1, 1))
"""Patch size, stride and zero padding at each edge [px]."""

Array = np.ndarray


def small(picture: Array) -> Array:
    """The middle square of a picture, scaled down: each pixel is the mean of a block.

    Training and acting use the same function.

    Args:
        picture: (height, width, 3), uint8; height a multiple of `SIDE`, width at least the height.

    Returns:
        (SIDE, SIDE, 3), uint8.

    Raises:
        ValueError: It has another shape.
    """
    shape = np.shape(picture)
    if len(shape) != 3 or shape[2] != 3 or shape[0] % SIDE or not 0 < shape[0] <= shape[1]:
        raise ValueError(
            f"a picture of shape {shape}: a height of {SIDE}, {2 * SIDE}, {3 * SIDE}, ... pixels"
            " is needed, at least as much width, and three colours"
        )
    height, block, left = shape[0], shape[0] // SIDE, (shape[1] - shape[0]) // 2
    middle = picture[:, left : left + height]
    rows = middle.reshape(SIDE, block, 3 * height).sum(axis=1, dtype=np.uint32)
    sums = rows.reshape(SIDE, SIDE, block, 3).sum(axis=2, dtype=np.uint32)
    return ((sums + block**2 // 2) // block**2).astype(np.uint8)


def stacked(now: Array, earlier: Sequence[Array]) -> Array:
    """Input of the network: the present picture in colour, earlier ones in grey.

    Args:
        now: (B, SIDE, SIDE, 3), uint8.
        earlier: One such array for each of `EARLIER`.

    Returns:
        (B, SIDE, SIDE, CHANNELS), float32, about -2 to 2.
    """
    found = np.empty((*now.shape[:3], CHANNELS), np.float32)
    found[..., :3] = now
    for i, views in enumerate(earlier):
        found[..., 3 + i] = np.einsum("bhwc->bhw", views, dtype=np.float32) / 3.0
    found -= 128.0
    found /= 64.0
    return found


def numbers(columns: Array, state: Array, last: Array) -> Array:
    """Measured inputs beside the picture at each of T successive steps of one episode.

    Args:
        columns: Of `state_columns`.
        state: (T, 9) `observation.state`.
        last: (T, 4) tip and roll of the last command; at the first step, the set-point.

    Returns:
        (T, NUMBERS): tip and roll relative to the last command, the jaw angle now and earlier, and
        the last command (`HERE`).
    """
    s = state[:, columns]
    row = np.arange(len(s))
    jaws = [s[np.maximum(row - lag, 0), 4] for lag in (0, *JAW_LAGS)]
    return np.column_stack([s[:, :4] - last, *jaws, last])


def patches(x: Array, size: int, stride: int, pad: int) -> Array:
    """Patches of pictures, which a convolution multiplies by its weights.

    Args:
        x: (B, H, W, C).
        size: Side of a patch.
        stride: From one patch to the next.
        pad: Zeros at each edge.

    Returns:
        (B, H', W', size * size * C).
    """
    B, H, W, C = x.shape
    padded = np.zeros((B, H + 2 * pad, W + 2 * pad, C), x.dtype)
    padded[:, pad : pad + H, pad : pad + W] = x
    h, w = ((n + 2 * pad - size) // stride + 1 for n in (H, W))
    b, r, c, one = padded.strides
    # A row of a patch is contiguous in memory.
    view = np.lib.stride_tricks.as_strided(
        padded, (B, h, w, size, size * C), (b, r * stride, c * stride, r, one), writeable=False
    )
    return view.reshape(B, h, w, size * size * C)


def grid(h: int, w: int, dtype: Any) -> Array:
    """Coordinates of a map's cells, -1 to 1, (h * w, 2): down, right."""
    down, right = np.meshgrid(np.linspace(-1, 1, h), np.linspace(-1, 1, w), indexing="ij")
    return np.column_stack([down.ravel(), right.ravel()]).astype(dtype)


def shares(maps: Array) -> Array:
    """Spatial softmax of each map, (B, h * w, C)."""
    flat = maps.reshape(len(maps), -1, maps.shape[3])
    powers = np.exp(flat - flat.max(axis=1, keepdims=True))
    return powers / powers.sum(axis=1, keepdims=True)


def places(maps: Array, share: Array) -> Array:
    """Expected position under each map's spatial softmax, and each map's mean.

    Args:
        maps: (B, h, w, C).
        share: Of `shares`.

    Returns:
        (B, 3 C): expected position (down, then right) of each map, then the means.
    """
    where = np.matmul(share.transpose(0, 2, 1), grid(*maps.shape[1:3], maps.dtype))
    means = maps.mean(axis=(1, 2))
    return np.concatenate([where[..., 0], where[..., 1], means], axis=1)


class ImageNetwork:
    """Convolutions, spatial softmax and a multilayer perceptron; float32.

    Spatial softmax gives positions as coordinates (Levine et al. 2016). Few weights are then needed
    after the convolutions, and a position is finer than a cell of the map.

    Args:
        layers: Weights (n_in, n_out) and biases: of `CONVOLUTIONS`, then of the perceptron, whose
            inputs are `places` and numbers.
    """

    def __init__(self, layers: Sequence[tuple[Array, Array]]) -> None:
        self.layers = list(layers)
        self.convolutions = self.layers[: len(CONVOLUTIONS)]
        self.head = Network(self.layers[len(CONVOLUTIONS) :])

    def maps(self, x: Array) -> Array:
        """(B, H, W, C) to (B, h, w, maps)."""
        for i, ((weight, bias), shape) in enumerate(
            zip(self.convolutions, CONVOLUTIONS, strict=True)
        ):
            x = patches(x, *shape) @ weight + bias
            if i < len(CONVOLUTIONS) - 1:
                x = np.maximum(x, 0.0)
        return x

    def __call__(self, pictures: Array, numbers: Array) -> Array:
        """(B, SIDE, SIDE, CHANNELS) and (B, NUMBERS), normalised, to (B, n_out)."""
        maps = self.maps(pictures)
        return self.head(np.concatenate([places(maps, shares(maps)), numbers], axis=1))


class ImagePolicy(Policy):
    """A policy that reads the endoscope's left picture and measured values."""

    format = "surg_bgr_image_policy/1"
    wants = (STATE, PICTURE)
    network_type = ImageNetwork

    def _find_columns(self) -> Any:
        return state_columns(self.names[STATE])

    def reset(self, instruction: str = "", seed: int | None = None) -> None:
        """Forget the last episode."""
        super().reset(instruction, seed)
        self._views: deque[Array] = deque(maxlen=max(EARLIER) + 1)

    def look(self, pictures: Array, measured: Array, last: Array) -> Array:
        """Chunks of actions for pictures and measured inputs.

        Args:
            pictures: (T, SIDE, SIDE, CHANNELS) of `stacked`.
            measured: (T, NUMBERS) of `numbers`.
            last: (T, 4) tip and roll of the last command; actions are relative to it.

        Returns:
            (T, K, 5) tip [m], roll [rad], jaw [rad]; absolute.
        """
        x = (measured - self.scales["input_mean"]) / self.scales["input_std"]
        return self.actions(self.network(pictures, x.astype(np.float32)), last)

    def act(self, observation: Any) -> Array:
        """The next actions, (K, 5), from an observation (`surg_policy_client.Observation`)."""
        arrays = self.see(observation)
        state = np.asarray(arrays[STATE], np.float64).ravel()
        self._views.append(small(np.asarray(arrays[PICTURE])))
        last = self.last_command(state[self._columns][SET])
        self._past.append((state, last))
        states, lasts = (np.array(part) for part in zip(*self._past, strict=True))
        before = [self._views[max(-1 - lag, -len(self._views))][None] for lag in EARLIER]
        pictures = stacked(self._views[-1][None], before)
        chunk = self.look(pictures, numbers(self._columns, states, lasts)[-1:], last[None])[0]
        self._said = chunk[0, :4]
        return chunk


if __name__ == "__main__":
    sys.exit(serve(ImagePolicy, (__doc__ or "").split("\n")[0]))
