"""The common style of all figures, and how they are saved."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

Figures = Mapping[str, tuple[str, str, Callable[..., Figure | None]]]
"""Name → the question that the figure answers, caption, function that draws it.

It returns None where there is nothing to show.
"""

INK, FAINT, GRID = "#1f2933", "#7b8794", "#e4e7eb"
EXECUTED_FAINT, TRUE_FAINT = "#74a9d8", "#e8ad80"
INPUT, EXECUTED, TRUE, LIMIT = "#8a94a0", "#1d6fb8", "#d9762b", "#c62f3b"

STYLE: dict[str, Any] = {
    "figure.facecolor": "white",
    "figure.dpi": 100,
    "savefig.dpi": 150,
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelcolor": INK,
    "axes.edgecolor": FAINT,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.8,
    "xtick.color": FAINT,
    "ytick.color": FAINT,
    "text.color": INK,
    "lines.linewidth": 1.1,
    "legend.frameon": False,
    "legend.fontsize": 9,
    "path.simplify_threshold": 0.5,
}

FOOTNOTE = 110
"""Characters of a line below a figure."""
WIDTH = 9.0
"""Width of every figure [inch]."""


@dataclasses.dataclass(frozen=True)
class Drawn:
    """One figure on disk."""

    title: str
    caption: str
    path: Path


def blank(height: float) -> Figure:
    """An empty figure of the common width and this height [inch]."""
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.09, h_pad=0.09)
    FigureCanvasAgg(figure)
    return figure


SVG_LIMIT = 400_000
"""Size of an SVG [bytes] above which a PNG is embedded instead."""


def encoded(figure: Figure) -> tuple[bytes, str]:
    """A figure for a page, and its kind: a small SVG, else a PNG."""
    buffer = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "page", "svg.fonttype": "none"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    if buffer.tell() <= SVG_LIMIT:
        return buffer.getvalue(), "svg+xml"
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=150)
    return buffer.getvalue(), "png"


def save_all(
    figures: Figures, folder: Path, *arguments: Any, formats: Sequence[str] = ("png",)
) -> list[Drawn]:
    """Draw figures from ``arguments`` and write them as ``<folder>/<name>.<format>``.

    One that has nothing to show is left out.
    """
    folder.mkdir(parents=True, exist_ok=True)
    drawn = []
    for name, (title, caption, draw) in figures.items():
        with matplotlib.rc_context({**STYLE, "svg.hashsalt": name}):
            figure = draw(*arguments)
            if figure is None:
                continue  # nothing to show
            for kind in formats:  # without what would differ between two runs
                unwanted = {"png": "Software", "svg": "Date"}[kind]
                figure.savefig(folder / f"{name}.{kind}", metadata={unwanted: None})
        drawn.append(Drawn(title, caption, folder / f"{name}.png"))
    return drawn
