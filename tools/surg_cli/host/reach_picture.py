"""What `surg reach` found, drawn: two planes through the home axis, three figures in each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from surg_core.tip_reach import Reach

FIGURES = (
    ("fastest tip in any direction", "m/s", "speed", 1.0, 0.3),
    ("nearest joint limit", "rad", "margin", 1.0, None),
    ("clearance to other arms and obstacles", "mm", "clearance", 1000.0, None),
)
PLANES = ((0, "x"), (1, "y"))
"""Quarter turns from x of the rcm frame, and the axis that lies in the plane."""


def draw(reaches: Sequence[Reach], path: Path) -> None:
    """Draw a page with two rows per arm."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    rows = 2 * len(reaches)
    figure, axes = plt.subplots(rows, 3, figsize=(12.5, 3.4 * rows), squeeze=False)
    for i, reach in enumerate(reaches):
        for quarter, letter in PLANES:
            for column, (title, unit, field, factor, most) in enumerate(FIGURES):
                axis = axes[2 * i + quarter][column]
                _plane(axis, reach, quarter, getattr(reach, field) * factor, most, unit)
                axis.set_title(f"{reach.arm}: {title}", fontsize=10)
                axis.set_xlabel(f"{letter} of the rcm frame [mm]", fontsize=8)
                axis.set_ylabel("depth [mm]", fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=100)
    plt.close(figure)


def _plane(
    axis: Any, reach: Reach, quarter: int, values: Any, most: float | None, unit: str
) -> None:
    """One figure in the plane of a turn and its opposite.

    Grey: out of reach. Red line: the clearance guard stops the arm there.
    """
    import numpy as np

    turns = len(reach.turns)
    near = quarter * turns // 4
    far = (near + turns // 2) % turns
    tilts = np.concatenate([-reach.tilts[:0:-1], reach.tilts])
    plane = np.concatenate([values[:0:-1, far], values[:, near]])  # (tilt, depth)
    tilt, depth = np.meshgrid(_edges(tilts), _edges(reach.depths), indexing="ij")
    x, z = 1e3 * depth * np.sin(tilt), 1e3 * depth * np.cos(tilt)
    axis.pcolormesh(x, z, np.zeros(plane.shape), cmap="Greys", vmin=-1.0, vmax=2.0)
    shown = np.ma.masked_invalid(plane)
    if shown.count():
        mesh = axis.pcolormesh(x, z, shown, cmap="viridis", vmin=0.0, vmax=most)
        axis.figure.colorbar(mesh, ax=axis, label=unit, fraction=0.03)
    else:
        axis.text(0.5, 0.5, "nothing near", transform=axis.transAxes, ha="center", fontsize=9)
    tilt, depth = np.meshgrid(tilts, reach.depths, indexing="ij")
    x, z = 1e3 * depth * np.sin(tilt), 1e3 * depth * np.cos(tilt)
    blocked = np.concatenate([~reach.free[:0:-1, far], ~reach.free[:, near]]).astype(float)
    if blocked.any() and not blocked.all():
        axis.contour(x, z, blocked, levels=[0.5], colors="red", linewidths=1.5)
    axis.plot([0.0], [0.0], "k+", markersize=9)
    axis.set_aspect("equal")
    axis.invert_yaxis()
    axis.tick_params(labelsize=7)


def _edges(centres: Any) -> Any:
    """The borders of evenly spaced samples."""
    import numpy as np

    half = 0.5 * (centres[1] - centres[0])
    return np.append(centres - half, centres[-1] + half)
