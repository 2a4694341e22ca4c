"""Finding a glowing bead in a stereo pair and where it is, by the projection matrices alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def centre(picture: NDArray[np.uint8]) -> Array:
    """Pixel (x, y) of what glows green, weighted by how green it is."""
    r, g, b = (picture[..., i].astype(float) for i in range(3))
    weight = np.clip(g - np.maximum(r, b), 0.0, None)
    weight[weight < 40] = 0.0
    assert weight.sum() > 0, "the bead is not in the picture"
    y, x = np.mgrid[: picture.shape[0], : picture.shape[1]]
    return np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()


def triangulate(projections: Sequence[Array], pixels: Sequence[Array]) -> Array:
    """The point (3,) whose pictures P [x y z 1]' are nearest to the pixels, by least squares."""
    rows, values = [], []
    for P, pixel in zip(projections, pixels, strict=True):
        for axis in range(2):
            row = P[axis] - pixel[axis] * P[2]
            rows.append(row[:3])
            values.append(-row[3])
    return np.asarray(np.linalg.lstsq(np.array(rows), np.array(values), rcond=None)[0])
