"""Pictures of depth for people: near is red, far is blue, unknown is black, with a scale in mm."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from surg_perception.depth.rectification import Picture

STRIP = 72
"""[px] Width of the scale at the right edge."""


def coloured(depth: npt.NDArray[np.float32], near: float, far: float) -> Picture:
    """(h, w, 3) rgb8 of a depth picture [m], from near to far [m]."""
    known = np.isfinite(depth)
    share = np.where(known, (far - np.where(known, depth, far)) / (far - near), 0.0)
    levels = np.round(255.0 * np.clip(share, 0.0, 1.0)).astype(np.uint8)
    picture = cv2.cvtColor(cv2.applyColorMap(levels, cv2.COLORMAP_TURBO), cv2.COLOR_BGR2RGB)
    picture[~known] = 0
    return np.asarray(picture)


def beside(left: Picture, depth: npt.NDArray[np.float32], near: float, far: float) -> Picture:
    """The left picture, its depth, and a scale: (h', w', 3), both sides even, rgb8."""
    whole = np.hstack([left, coloured(depth, near, far), scale(left.shape[0], near, far)])
    height = len(whole)
    return np.ascontiguousarray(whole[: height - height % 2, : whole.shape[1] - whole.shape[1] % 2])


def scale(height: int, near: float, far: float) -> Picture:
    """(height, STRIP, 3) rgb8: the colours from near to far [m], with figures in mm."""
    ramp = np.linspace(near, far, height, dtype=np.float32)[:, None].repeat(12, axis=1)
    strip = np.full((height, STRIP, 3), 255, np.uint8)
    strip[:, :12] = coloured(ramp, near, far)
    for share in (0.02, 0.25, 0.5, 0.75, 0.98):
        text = f"{1e3 * (near + share * (far - near)):.0f} mm"
        place = (15, int(share * (height - 1)) + 4)
        cv2.putText(strip, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.4, (0, 0, 0), 1, cv2.LINE_AA)
    return strip


def shown_range(depth: npt.NDArray[np.float32]) -> tuple[float, float]:
    """Distances [m] between which the scale shows best; any where nothing is known."""
    known = depth[np.isfinite(depth)]
    if not len(known):
        return 0.05, 0.15
    near, far = (float(value) for value in np.percentile(known, (2, 98)))
    return near, max(far, near + 0.005)
