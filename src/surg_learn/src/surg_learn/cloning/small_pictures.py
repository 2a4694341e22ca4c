"""Pictures of an endoscope as networks take them: the middle square, scaled down; numpy only."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

Array = np.ndarray
SIDE = 120
"""Side of the scaled picture [px]."""


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


def check_size(folder: Path, key: str, shape: Sequence[int]) -> None:
    """Refuse pictures that the eye cannot take.

    Args:
        folder: Of the dataset.
        key: Of the pictures.
        shape: Height, width, 3 [px].

    Raises:
        ValueError: They do not fit.
    """
    try:
        small(np.zeros(shape, np.uint8))
    except ValueError as problem:
        where = f"{folder}: {key} has the shape {list(shape)} (meta/info.json)"
        raise ValueError(f"{where}; {problem}") from None


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
