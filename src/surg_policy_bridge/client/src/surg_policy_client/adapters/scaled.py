"""Pictures of the size that a model was trained with, as `./surg episode export --size` scales."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from surg_policy_client.errors import SpecMismatch


def scaled(picture: np.ndarray, height: int, width: int) -> np.ndarray:
    """A picture made smaller: each pixel is the mean of the area that it covers.

    Args:
        picture: (H, W, 3) uint8.
        height: At most H.
        width: At most W.

    Returns:
        (height, width, 3) uint8; the same array if the size is the same.

    Raises:
        SpecMismatch: It would become larger, or be stretched. Says both sizes.
    """
    tall, wide = picture.shape[:2]
    if (tall, wide) == (height, width):
        return picture
    if height > tall or width > wide or height * wide != width * tall:
        raise SpecMismatch(
            f"the model was trained with pictures of {width} x {height}, the server's are "
            f"{wide} x {tall}: they are made smaller, but neither larger nor stretched"
        )
    down, across = _shares(tall, height), _shares(wide, width)
    rows = np.tensordot(down, picture.astype(np.float32), 1)
    mean = np.einsum("hwc,vw->hvc", rows, across, optimize=True)
    return np.floor(mean + 0.5).astype(np.uint8)


@lru_cache(maxsize=16)
def _shares(large: int, small: int) -> np.ndarray:
    """Share of each of `large` pixels in each of `small` ones, (small, large)."""
    edges = np.arange(small + 1) * (large / small)
    pixels = np.arange(large + 1)
    begin = np.maximum(edges[:-1, None], pixels[None, :-1])
    end = np.minimum(edges[1:, None], pixels[None, 1:])
    shares: np.ndarray = np.maximum(end - begin, 0.0) * (small / large)
    return shares.astype(np.float32)
