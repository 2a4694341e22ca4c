"""Drawings of a calibration's report, in SVG: residuals in a picture, lines in space, bars."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from surg_core.transforms import FloatArray
from surg_perception.calibration.intrinsics import SeenCorners

WIDE, HIGH, EDGE = 600, 440, 50
"""[px] Size of a drawing in space, and the edge that its axes have."""
BAR, BAR_GAP = 18, 30
"""[px] Height of a bar, and distance from one to the next."""


@dataclass(frozen=True)
class Line:
    """A line of a drawing in space.

    Attributes:
        points: ``(n, 3)`` [m].
        colour: Of CSS.
        label: Text at the last point; empty: none.
        dot: Whether the first point has a dot.
    """

    points: FloatArray
    colour: str
    label: str = ""
    dot: bool = False


def colour(number: int) -> str:
    """A colour that differs from its neighbours'."""
    return f"hsl({137 * number % 360},70%,40%)"


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
) -> str:
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
    lines = [
        _arrow(pixel, pixel + factor * away, colour(view), unit)
        for view, (corners, each) in enumerate(zip(seen, residuals, strict=True))
        for pixel, away in zip(corners.pixels, each, strict=True)
    ]
    bar = nice(0.1 * width / factor)
    end = np.array([10.0 * unit + bar * factor, 14.0 * unit])
    lines.append(_arrow(np.array([10.0 * unit, 14.0 * unit]), end, "black", unit))
    lines.append(_text(end + np.array([6.0, 5.0]) * unit, f"{bar:g} px", size=14.0 * unit))
    note = f"{title}; arrows {factor:g} times as long"
    return figure(note, width, height, lines)


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


def above_and_side(lines: Sequence[Line], frame: str) -> str:
    """Lines in an optical frame (x right, y down, z away): from above, and from the right."""
    above = in_space(f"from above, {frame}", lines, (0, 2), ("x", "z"))
    return above + in_space(f"from the right, {frame}", lines, (2, 1), ("z", "y"), down=True)


def front_and_side(lines: Sequence[Line], frame: str) -> str:
    """Lines in a frame with z up: from the front, and from the right."""
    front = in_space(f"from the front, {frame}", lines, (0, 2), ("x", "z"))
    return front + in_space(f"from the right, {frame}", lines, (1, 2), ("y", "z"))


def in_space(
    title: str,
    lines: Sequence[Line],
    axes: tuple[int, int],
    names: tuple[str, str],
    down: bool = False,
) -> str:
    """Lines along one axis of their frame, with equal scales.

    Args:
        title: Of the drawing.
        lines: What is drawn.
        axes: Numbers of the axes that point right and up.
        names: Of these axes.
        down: The second axis points down.
    """
    sign = np.array([1.0, -1.0 if down else 1.0])
    flat = [1e3 * line.points[:, list(axes)] * sign for line in lines]
    low, high = np.concatenate(flat).min(axis=0), np.concatenate(flat).max(axis=0)
    middle, inner = (low + high) / 2.0, np.array([WIDE, HIGH]) - 2.0 * EDGE
    scale = float(np.min(inner / np.maximum(high - low, 1.0)))

    def place(p: FloatArray) -> FloatArray:
        return np.array([WIDE, HIGH]) / 2.0 + (p - middle) * scale * [1.0, -1.0]

    drawn = _grid(place, middle, inner / scale, names, sign)
    for line, p in zip(lines, flat, strict=True):
        at = np.array([place(each) for each in p])
        drawn.append(_path(at, line.colour))
        if line.dot:
            drawn.append(_dot(at[0], line.colour, 2.5))
        if line.label:
            drawn.append(_label(at[-1], line))
    return figure(title, WIDE, HIGH, drawn)


def bars(title: str, values: Mapping[str, float], unit: str) -> str:
    """Named values as bars from zero."""
    most = max([*values.values(), 1e-12])
    drawn = []
    for row, (name, value) in enumerate(values.items()):
        y, long = 12 + BAR_GAP * row, 320.0 * value / most
        fill = colour(row)
        drawn.append(_text(np.array([8.0, y + 14.0]), name))
        drawn.append(f'<rect x="150" y="{y}" width="{long:.1f}" height="{BAR}" fill="{fill}"/>')
        drawn.append(_text(np.array([158.0 + long, y + 14.0]), f"{value:.3f} {unit}"))
    return figure(title, WIDE, 12 + BAR_GAP * len(values), drawn)


def figure(title: str, width: int, height: int, drawn: Sequence[str]) -> str:
    """A drawing with its title."""
    return (
        f"<figure><figcaption>{html.escape(title)}</figcaption>"
        f'<svg viewBox="0 0 {width} {height}">{"".join(drawn)}</svg></figure>'
    )


def page(title: str, facts: Mapping[str, str], drawings: Sequence[str]) -> str:
    """The page: facts as a table, then the drawings; nothing is loaded from outside."""
    rows = "".join(
        f"<tr><th>{html.escape(name)}</th><td>{html.escape(value)}</td></tr>"
        for name, value in facts.items()
    )
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{html.escape(title)}</title>'
        "<style>body{font-family:sans-serif;margin:1em}figure{display:inline-block;margin:0.5em 0;"
        "width:49%;vertical-align:top}svg{border:1px solid #999;width:98%;background:white}"
        "th{text-align:left;padding-right:1em}"
        "text{paint-order:stroke;stroke:white;stroke-width:3px}</style>"
        f"<h1>{html.escape(title)}</h1><table>{rows}</table>{''.join(drawings)}</html>\n"
    )


def _grid(
    place: object, middle: FloatArray, extent: FloatArray, names: tuple[str, str], sign: FloatArray
) -> list[str]:
    """Lines of whole steps with their numbers [mm]."""
    assert callable(place)
    step, drawn = nice(float(extent.max()) / 4.0), []
    for axis in (0, 1):
        first = math.ceil((middle[axis] - extent[axis] / 2.0) / step - 1e-9)
        last = math.floor((middle[axis] + extent[axis] / 2.0) / step + 1e-9)
        for tick in range(first, last + 1):
            at = middle.copy()
            at[axis] = tick * step
            x, y = place(at)
            word = f"{sign[axis] * tick * step + 0.0:g}"
            if axis == 0:
                drawn.append(_path(np.array([[x, EDGE], [x, HIGH - EDGE]]), "#ddd"))
                drawn.append(_text(np.array([x - 8.0, HIGH - EDGE + 18.0]), word))
            else:
                drawn.append(_path(np.array([[EDGE, y], [WIDE - EDGE, y]]), "#ddd"))
                drawn.append(_text(np.array([8.0, y + 4.0]), word))
    drawn.append(_text(np.array([WIDE - EDGE - 30.0, HIGH - 10.0]), f"{names[0]} [mm]"))
    drawn.append(_text(np.array([8.0, 20.0]), f"{names[1]} [mm]"))
    return drawn


def _arrow(start: FloatArray, end: FloatArray, fill: str, unit: float) -> str:
    """A line with a dot at its start."""
    return _path(np.array([start, end]), fill, unit) + _dot(start, fill, 1.5 * unit)


def _path(points: FloatArray, stroke: str, width: float = 1.0) -> str:
    if len(points) == 2:
        (x, y), (u, v) = points
        ends = f'x1="{x:.1f}" y1="{y:.1f}" x2="{u:.1f}" y2="{v:.1f}"'
        return f'<line {ends} stroke="{stroke}" stroke-width="{width:g}"/>'
    along = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<polyline points="{along}" fill="none" stroke="{stroke}" stroke-width="{width:g}"/>'


def _dot(at: FloatArray, fill: str, radius: float) -> str:
    return f'<circle cx="{at[0]:.1f}" cy="{at[1]:.1f}" r="{radius:g}" fill="{fill}"/>'


def _label(at: FloatArray, line: Line) -> str:
    """The label beside the last point, on the side that has room."""
    room = at[0] + 8.0 * len(line.label) < WIDE - 4.0
    aside = np.array([4.0, -4.0]) if room else np.array([-4.0 - 7.0 * len(line.label), -4.0])
    return _text(at + aside, line.label, line.colour)


def _text(at: FloatArray, words: str, fill: str = "black", size: float = 13.0) -> str:
    return (
        f'<text x="{at[0]:.1f}" y="{at[1]:.1f}" font-size="{size:g}" fill="{fill}">'
        f"{html.escape(words)}</text>"
    )
