"""Drawings of a calibration's report: residuals in a picture, lines in space, bars."""

from __future__ import annotations

import colorsys
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from surg_core.transforms import FloatArray
from surg_perception.calibration.intrinsics import SeenCorners
from surg_recording.reports.figure_style import STYLE

SIZE = (6.0, 4.4)
"""[inch] Width and height of a drawing."""
Colour = tuple[float, float, float]
BLACK: Colour = (0.0, 0.0, 0.0)
_HALO = [withStroke(linewidth=2.0, foreground="white")]


@dataclass(frozen=True)
class Drawing:
    """A figure and what it shows."""

    title: str
    figure: Figure


@dataclass(frozen=True)
class Line:
    """A line of a drawing in space.

    Attributes:
        points: ``(n, 3)`` [m].
        colour: Red, green, blue from 0 to 1.
        label: Text at the last point; empty: none.
        dot: Whether the first point has a dot.
    """

    points: FloatArray
    colour: Colour
    label: str = ""
    dot: bool = False


def colour(number: int) -> Colour:
    """A colour that differs from its neighbours'."""
    return colorsys.hls_to_rgb(137 * number % 360 / 360, 0.4, 0.7)


def nice(value: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above a positive value."""
    power = 10.0 ** math.floor(math.log10(value))
    return max(factor * power for factor in (1.0, 2.0, 5.0) if factor * power <= value * 1.0001)


def magnification(lengths: FloatArray, wanted: float) -> float:
    """A factor by which lengths (n,) become about ``wanted`` long (rms)."""
    return nice(max(wanted, 1e-9) / max(float(np.sqrt(np.mean(lengths**2))), 1e-12))


def residuals_in_picture(
    title: str,
    size: tuple[int, int],
    seen: Sequence[SeenCorners],
    residuals: Sequence[FloatArray],
) -> Drawing:
    """Residuals as arrows from the corners, each view in a colour.

    Args:
        title: Of the drawing.
        size: Width and height of the picture [px].
        seen: Corners of each view in this eye.
        residuals: (n, 2) of each view [px].
    """
    width, height = size
    lengths = np.linalg.norm(np.concatenate(residuals), axis=1)
    factor, unit = magnification(lengths, 0.02 * width), width / 640.0
    axes = _axes()
    for view, (corners, each) in enumerate(zip(seen, residuals, strict=True)):
        ends = corners.pixels + factor * each
        arrows = np.stack([corners.pixels, ends], axis=1)
        axes.add_collection(LineCollection(arrows, colors=[colour(view)], linewidths=0.9))
        axes.plot(*corners.pixels.T, ".", color=colour(view), markersize=2.5)
    bar = nice(0.1 * width / factor)
    start, end = 10.0 * unit, 10.0 * unit + bar * factor
    axes.plot([start, end], [14.0 * unit] * 2, color=BLACK, linewidth=1.2)
    axes.text(end + 6.0 * unit, 14.0 * unit, f"{bar:g} px", va="center", path_effects=_HALO)
    axes.set(xlim=(0, width), ylim=(height, 0), aspect="equal", xticks=[], yticks=[])
    axes.spines[:].set_visible(True)
    return Drawing(f"{title}; arrows {factor:g} times as long", axes.figure)


def residuals_in_space(
    p: FloatArray, residuals: FloatArray, names: Sequence[str]
) -> tuple[list[Line], float]:
    """Residuals (n, 3) at points p (n, 3) [m] as lines, and how many times as long they are."""
    extent = float(np.ptp(p, axis=0).max())
    factor = magnification(np.linalg.norm(residuals, axis=1), 0.06 * extent)
    lines = [
        Line(np.array([a, a + factor * r]), colour(number), name, dot=True)
        for number, (a, r, name) in enumerate(zip(p, residuals, names, strict=True))
    ]
    return lines, factor


def above_and_side(lines: Sequence[Line], frame: str) -> list[Drawing]:
    """Lines in an optical frame (x right, y down, z away): from above, and from the right."""
    above = in_space(f"from above, {frame}", lines, (0, 2), ("x", "z"))
    return [above, in_space(f"from the right, {frame}", lines, (2, 1), ("z", "y"), down=True)]


def front_and_side(lines: Sequence[Line], frame: str) -> list[Drawing]:
    """Lines in a frame with z up: from the front, and from the right."""
    front = in_space(f"from the front, {frame}", lines, (0, 2), ("x", "z"))
    return [front, in_space(f"from the right, {frame}", lines, (1, 2), ("y", "z"))]


def in_space(
    title: str,
    lines: Sequence[Line],
    shown: tuple[int, int],
    names: tuple[str, str],
    down: bool = False,
) -> Drawing:
    """Lines along one axis of their frame, with equal scales.

    Args:
        title: Of the drawing.
        lines: What is drawn.
        shown: Numbers of the axes that point right and up.
        names: Of these axes.
        down: The second axis points down.
    """
    axes = _axes()
    for line in lines:
        flat = 1e3 * line.points[:, list(shown)]
        first = {"marker": "o", "markersize": 3.5, "markevery": [0]} if line.dot else {}
        axes.plot(*flat.T, color=line.colour, linewidth=1.0, **first)
        beside = {"xytext": (4, 4), "textcoords": "offset points", "path_effects": _HALO}
        axes.annotate(line.label, flat[-1], color=line.colour, **beside)
    axes.set(xlabel=f"{names[0]} [mm]", ylabel=f"{names[1]} [mm]")
    points = np.concatenate([1e3 * line.points[:, list(shown)] for line in lines])
    low, high, ratio = points.min(axis=0), points.max(axis=0), SIZE[1] / SIZE[0]
    half = 0.56 * max(high[0] - low[0], (high[1] - low[1]) / ratio, 1.0)
    (x, y), up = (low + high) / 2.0, -1.0 if down else 1.0
    axes.set(xlim=(x - half, x + half), ylim=(y - up * half * ratio, y + up * half * ratio))
    axes.set_aspect("equal")
    return Drawing(title, axes.figure)


def bars(title: str, values: Mapping[str, float], unit: str) -> Drawing:
    """Named values as bars from zero."""
    axes = _axes(0.6 + 0.35 * len(values))
    colours = [colour(row) for row in range(len(values))]
    drawn = axes.barh(list(values), list(values.values()), color=colours, height=0.6)
    axes.bar_label(drawn, [f"{value:.3f} {unit}" for value in values.values()], padding=4)
    axes.set(xticks=[])
    axes.margins(x=0.25)
    axes.invert_yaxis()
    return Drawing(title, axes.figure)


def _axes(height: float = SIZE[1]) -> Axes:
    with matplotlib.rc_context(STYLE):
        return Figure(figsize=(SIZE[0], height), layout="constrained").subplots()
