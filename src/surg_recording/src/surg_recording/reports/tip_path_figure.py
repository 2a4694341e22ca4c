"""The path of the tip about the trocar, with the fan of shaft positions."""

from __future__ import annotations

from typing import Any

import matplotlib
import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from surg_core.transforms import rotate_back
from surg_recording.reports.figure_style import EXECUTED, FAINT, GRID, INPUT, TRUE, blank
from surg_recording.reports.run_series import Run

Array = npt.NDArray[np.float64]


def tip_path(run: Run) -> Figure:
    """Input and executed tip path about the trocar, with the shaft's fan."""
    figure = blank(5.2)
    figure.set_layout_engine("none")  # a 3D axes reserves far more room than it draws
    space = figure.add_axes((0.02, 0.1, 0.36, 0.8), projection="3d")
    side = figure.add_axes((0.44, 0.11, 0.2, 0.82))
    top = figure.add_axes((0.69, 0.4, 0.29, 0.53))
    given, done = _in_rcm(run, run.t_input, run.input), _in_rcm(run, run.t_executed, run.executed)
    inside = (run.t_input >= run.t[0]) & (run.t_input <= run.t[-1])
    given = given[inside]
    fan = _fan(run)
    for line in fan:
        space.plot(*_plotted(line), color=FAINT, linewidth=0.5, alpha=0.45)
        side.plot(line[:, 0], line[:, 2], color=FAINT, linewidth=0.5, alpha=0.45)
    space.plot(*_plotted(given), color=INPUT, linewidth=2.2)
    space.plot(*_plotted(done), color=EXECUTED, linewidth=0.8)
    space.scatter([0], [0], [0], color=TRUE, s=30, depthshade=False)
    _equal_box(space, np.concatenate([done, given, *fan]))
    space.view_init(elev=14, azim=-60)
    for axes, (i, j), names in ((side, (0, 2), ("x", "depth")), (top, (0, 1), ("x", "y"))):
        axes.plot(given[:, i], given[:, j], color=INPUT, linewidth=2.2, label="input")
        axes.plot(done[:, i], done[:, j], color=EXECUTED, linewidth=0.8, label="executed")
        axes.set(xlabel=f"{names[0]} [mm]", ylabel=f"{names[1]} [mm]")
        axes.set_aspect("equal", adjustable="box")
        axes.set_anchor("NW")
    side.plot([0], [0], "o", color=TRUE, markersize=5, label="trocar")
    side.invert_yaxis()
    side.set_title("From the side")
    figure.text(0.02, 0.945, "Shaft fan through the trocar", fontweight="bold", size=10.5)
    for artist in (*space.lines, *space.collections):
        artist.set_clip_on(False)  # the box is drawn larger than its axes
    top.set_title("Along the home axis")
    handles, labels = side.get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower left", bbox_to_anchor=(0.69, 0.1))
    return figure


def _in_rcm(run: Run, t: Array, p_B: Array) -> Array:
    """Positions in the rcm frame [mm], by the frame of the cycle nearest in time."""
    row = np.clip(np.searchsorted(run.t, t), 0, len(run.t) - 1)
    q_BR = run.cycle.vector("q_br", "xyzw")[row]
    return np.asarray(rotate_back(q_BR, p_B - run.p_rcm[row]) * 1e3)


def _fan(run: Run) -> list[Array]:
    """Shaft segments in the rcm frame, from 40 mm outside the trocar to the tip [mm]."""
    rows = np.linspace(0, len(run.t_executed) - 1, 24).astype(int)
    t = run.t_executed[rows]
    tips, axes = run.executed[rows], run.shaft[rows]
    row = np.clip(np.searchsorted(run.t, t), 0, len(run.t) - 1)
    depth = np.sum((tips - run.p_rcm[row]) * axes, axis=1)
    outside = tips - axes * (depth + 0.04)[:, None]
    ends = np.stack([_in_rcm(run, t, outside), _in_rcm(run, t, tips)], axis=1)
    return list(ends)


def _plotted(points: Array) -> tuple[Array, Array, Array]:
    """Coordinates for a 3D axes whose vertical axis shows depth downwards."""
    return points[:, 0], points[:, 1], -points[:, 2]


def _equal_box(axes: Any, points: Array) -> None:
    """Equal scales in a 3D axes; depth is written as a positive number, downwards."""
    x, y, z = _plotted(points)
    spans = [max(float(np.ptp(v)), 1.0) for v in (x, y, z)]
    width = max(spans[0], spans[1])
    for set_limits, v in ((axes.set_xlim, x), (axes.set_ylim, y)):
        middle = (float(v.min()) + float(v.max())) / 2
        set_limits(middle - width / 2, middle + width / 2)
    axes.set_zlim(float(z.min()), max(float(z.max()), 20.0))
    axes.set_box_aspect((width, width, spans[2]), zoom=1.16)
    axes.zaxis.set_major_formatter(matplotlib.ticker.FuncFormatter(lambda v, _: f"{0 - v:g}"))
    axes.set_xlabel("x [mm]", labelpad=-2)
    axes.set_ylabel("y [mm]", labelpad=-2)
    axes.set_zlabel("depth [mm]", labelpad=4)
    axes.tick_params(labelsize=8, pad=0)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.pane.set_facecolor("#f7f8fa")
        axis.pane.set_edgecolor(GRID)
        axis._axinfo["grid"].update(color=GRID, linewidth=0.6)
        axis.set_major_locator(matplotlib.ticker.MaxNLocator(3 if axis is not axes.zaxis else 5))
