"""Pictures that say which they are, so that a frame that is out of place is seen.

Black and white squares: a number of 24 bits above, its complement below. It says which recording
it is of, which camera, and which frame; reading survives H.264. Needs numpy only: also read by
programs in other environments.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import numpy.typing as npt

WIDTH, HEIGHT = 96, 64
BITS, COLUMNS, ROWS = 24, 6, 4


@dataclasses.dataclass(frozen=True)
class Identity:
    """What a picture says."""

    recording: int
    camera: int
    frame: int

    def number(self) -> int:
        """As 24 bits: recording (8), camera (1), frame (15)."""
        return self.recording << 16 | self.camera << 15 | self.frame


def draw(identity: Identity, width: int = WIDTH, height: int = HEIGHT) -> npt.NDArray[np.uint8]:
    """The picture (height, width, 3), which are multiples of 6 and 8."""
    bits = np.array([identity.number() >> i & 1 for i in range(BITS)]).reshape(ROWS, COLUMNS)
    both = np.vstack([bits, 1 - bits])
    image = np.kron(both * 200 + 25, np.ones((height // (2 * ROWS), width // COLUMNS)))
    return np.repeat(image.astype(np.uint8)[..., None], 3, axis=2)


def shades(image: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Which squares (8, 6) are bright, and the mean colours (2, 3) of the dark and bright ones.

    Of every square its middle: its edges are what compression blurs.
    """
    pixels = np.asarray(image, dtype=float)
    high, wide = pixels.shape[0] // (2 * ROWS), pixels.shape[1] // COLUMNS
    pixels = pixels[: high * 2 * ROWS, : wide * COLUMNS]
    blocks = pixels.reshape(2 * ROWS, high, COLUMNS, wide, 3)
    middle = blocks[:, high // 4 : max(high - high // 4, 1), :, wide // 4 : wide - wide // 4]
    squares, grey = middle.mean(axis=(1, 3)), pixels.mean(axis=2)
    bright = squares.mean(axis=2) > (grey.max() + grey.min()) / 2
    return bright, np.stack([squares[bright == each].mean(axis=0) for each in (False, True)])


def read(image: npt.NDArray[Any]) -> Identity:
    """What a picture (height, width, 3) of any range of values says.

    Raises:
        ValueError: it is no such picture, or two are mixed.
    """
    bright, _ = shades(image)
    ones = bright.astype(int)
    if not np.array_equal(ones[:ROWS], 1 - ones[ROWS:]):
        raise ValueError("no picture of ours, or a mixture of two")
    number = int(sum(int(bit) << i for i, bit in enumerate(ones[:ROWS].ravel())))
    return Identity(number >> 16, number >> 15 & 1, number & 0x7FFF)
