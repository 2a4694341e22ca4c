"""A small image policy for bowel grasping and retraction: numpy only, nothing privileged.

    python3 examples/bgr_image_policy.py --weights weights.npz --server tcp://127.0.0.1:5555

`train_bgr.py --images` makes the weights. It looks at what a robot has: `observation.state` and the
left endoscope picture, its middle square made 96 x 96. Three convolutions and two full layers.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from bgr_policy import SET, STATE, Policy, serve

FORMAT = "surg_bgr_image_policy/1"
PICTURE = "observation.images.endoscope.left"
SIDE = 96
"""Of the square picture that the network sees [px]."""
CONVOLUTIONS = ((4, 4, 3, 24), (3, 2, 24, 32), (3, 2, 32, 48))
"""Size, stride, channels in and out; no padding. The first one looks at tiles of 4 x 4."""
FLAT = 5 * 5 * 48
"""Numbers behind the last convolution."""


def square(picture: np.ndarray) -> np.ndarray:
    """The middle square of a picture, made smaller by whole means.

    Args:
        picture: (height, width, 3) uint8, the smaller side a multiple of 96.

    Returns:
        (96, 96, 3) uint8.

    Raises:
        ValueError: Another size.
    """
    height, width, _ = picture.shape
    side = min(height, width)
    if side % SIDE:
        raise ValueError(
            f"picture {width} x {height}: the smaller side must be a multiple of {SIDE}"
        )
    top, left, k = (height - side) // 2, (width - side) // 2, side // SIDE
    cut = picture[top : top + side, left : left + side]
    tiles = cut.reshape(SIDE, k, SIDE, k, 3)
    return (tiles.sum(axis=(1, 3), dtype=np.uint32) // (k * k)).astype(np.uint8)


def windows(x: np.ndarray, size: int, stride: int) -> np.ndarray:
    """What each output of a convolution looks at.

    Args:
        x: (N, H, W, C).
        size: Of the window.
        stride: From one to the next.

    Returns:
        (N, h, w, size * size * C), a copy.
    """
    seen = np.lib.stride_tricks.sliding_window_view(x, (size, size), axis=(1, 2))
    seen = seen[:, ::stride, ::stride].transpose(0, 1, 2, 4, 5, 3)
    return seen.reshape(*seen.shape[:3], -1)


class ImageNetwork:
    """Weights (n_in, n_out) and biases: the convolutions', then the full layers', float32."""

    def __init__(self, layers: Sequence[tuple[np.ndarray, np.ndarray]]) -> None:
        self.layers = list(layers)

    def __call__(self, pictures: np.ndarray, state: np.ndarray) -> np.ndarray:
        """(N, 96, 96, 3) uint8 and (N, 9) normalised to (N, n_out) normalised."""
        x = pictures.astype(np.float32) / np.float32(255.0) - np.float32(0.5)
        for i, (size, stride, _, _) in enumerate(CONVOLUTIONS):
            weight, bias = self.layers[i]
            x = np.maximum(windows(x, size, stride) @ weight + bias, 0.0)
        x = np.hstack([x.reshape(len(x), -1), state.astype(np.float32)])
        for weight, bias in self.layers[len(CONVOLUTIONS) : -1]:
            x = np.maximum(x @ weight + bias, 0.0)
        weight, bias = self.layers[-1]
        return x @ weight + bias


class ImagePolicy(Policy):
    """As `bgr_policy.Policy`, of which it is the seeing sister. It remembers nothing."""

    format = FORMAT
    wants = (STATE, PICTURE)
    network_type = ImageNetwork

    def predict(self, pictures: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Chunks (N, K, 5), absolute, from pictures (N, 96, 96, 3) and states (N, 9)."""
        scales = self.scales
        x = (state - scales["input_mean"]) / scales["input_std"]
        y = self.network(pictures, x).astype(np.float64)
        y = (y * scales["output_std"] + scales["output_mean"]).reshape(len(x), self.chunk, 5)
        y[:, :, :4] += state[:, SET][:, None, :]
        y[:, :, 4] = np.clip(y[:, :, 4], *scales["jaw_range"])
        return y

    def act(self, observation: Any) -> np.ndarray | None:
        """See `bgr_policy.Policy`."""
        arrays = self.see(observation)
        state = np.asarray(arrays[STATE], np.float64).ravel()
        return self.predict(square(arrays[PICTURE])[None], state[None])[0]


if __name__ == "__main__":
    sys.exit(serve(ImagePolicy, (__doc__ or "").split("\n")[0]))
