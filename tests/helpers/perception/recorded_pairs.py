"""Videos of a stereo endoscope whose pictures hold their own number."""

from __future__ import annotations

import fractions
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
CELL = 16
BITS = 12


def scene(number: int, width: int, height: int, shade: int = 0) -> Image:
    """A picture with its number in black and white cells along the upper edge."""
    y, x = np.mgrid[:height, :width]
    wave = 120 + 60 * np.sin((x + 3 * number) / 31.0) + 40 * np.cos(y / 17.0) + shade
    picture = np.stack([wave, 0.8 * wave, 0.6 * wave], -1).clip(0, 255).astype(np.uint8)
    for bit in range(BITS):
        cell = 255 * (number >> bit & 1)
        picture[:CELL, CELL * bit : CELL * (bit + 1)] = cell
    return picture


def number_of(picture: Image) -> int:
    """The number in a picture of `scene`."""
    centres = picture[CELL // 2, CELL // 2 : CELL * BITS : CELL].mean(-1) > 127
    return int(sum(1 << bit for bit, white in enumerate(centres) if white))


def side_by_side(path: Path, count: int, width: int = 640, height: int = 480) -> Path:
    """Write a video of pairs, the right eye darker; lossless enough for its numbers."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=30)
        stream.width, stream.height, stream.pix_fmt = 2 * width, height, "yuv420p"
        stream.bit_rate = 20_000_000
        stream.codec_context.time_base = fractions.Fraction(1, 30)
        for number in range(count):
            pair = [scene(number, width, height, shade) for shade in (0, -60)]
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(np.hstack(pair)), "rgb24")
            frame.pts = number
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path
