"""Box plots of many episodes: a box per condition, a dot per episode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from surg_recording.reports import trials
from surg_recording.reports.figure_style import (
    EXECUTED,
    EXECUTED_FAINT,
    INK,
    LIMIT,
    TRUE,
    TRUE_FAINT,
    Figures,
    blank,
)
from surg_recording.reports.terms import named

Entries = Sequence[Mapping[str, Any]]
Groups = Sequence[tuple[str, Entries]]
"""Label and episodes of each condition."""
Series = Sequence[tuple[str, str, tuple[str, ...]]]
"""Label, colour, and path of the number in an episode, of each box in a group."""


def deviation(groups: Groups, summary: Mapping[str, Any]) -> Figure | None:
    """Mean and maximum of the RCM deviation of each episode: kinematic, and by the simulator.

    None: no episode has one.
    """
    panels = [
        panel
        for panel in (
            ("kinematic", "rcm_kinematic_mm", EXECUTED, EXECUTED_FAINT),
            ("true", "rcm_true_mm", TRUE, TRUE_FAINT),
        )
        if any(trials.values(entries, panel[1], "max") for _, entries in groups)
    ]
    if not panels:
        return None
    figure = blank(4.2)
    drawn = list(np.atleast_1d(figure.subplots(1, len(panels))))
    for axes, (name, key, colour, faint) in zip(drawn, panels, strict=True):
        series = [("mean", faint, (key, "mean")), ("max", colour, (key, "max"))]
        _boxes(axes, groups, series)
        axes.set_yscale("log")
        axes.margins(y=0.12)
        axes.yaxis.set_major_locator(matplotlib.ticker.LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(matplotlib.ticker.FuncFormatter(lambda y, _: f"{y:g}"))
        axes.yaxis.set_minor_formatter(matplotlib.ticker.NullFormatter())
        axes.set(title=f"RCM deviation, {name}", ylabel="RCM deviation of each episode [mm]")
    marks = [_bound_marks(drawn[0], i, c) for i, c in enumerate(summary["conditions"])]
    if any(marks):
        drawn[0].plot([], [], "--", color=LIMIT, lw=1.2, label="bound")
    for mark in summary.get("paper", ()):
        paper_mark(drawn[0], mark, groups)
    for axes in drawn:
        low, high = axes.get_ylim()
        axes.set_ylim(low, high * (high / low) ** 0.15)  # logarithmic: room for the legend
        axes.legend(loc="upper center", ncols=4, columnspacing=1.0, fontsize=8)
    return figure


def _bound_marks(axes: Axes, place: int, condition: Mapping[str, Any]) -> int:
    """Lines over the kinematic boxes of one condition; returns their number."""
    ends = {"mean": (-0.38, -0.02), "max": (0.02, 0.38)}
    bounds = condition.get("bounds", ())
    for bound in bounds:
        left, right = ends[bound["metric"]]
        axes.plot([place + left, place + right], [bound["value"]] * 2, "--", color=LIMIT, lw=1.2)
    return len(bounds)


def paper_mark(axes: Axes, mark: Mapping[str, Any], groups: Groups) -> None:
    """A published value beside the boxes of its setting; ``mark`` is of ``paper_values``."""
    labels = axes.get_legend_handles_labels()[1]
    for place, (_, entries) in enumerate(groups):
        of_the_task = all(entry.get("task", PAPER_TASK) == PAPER_TASK for entry in entries)
        if entries and of_the_task and all(e.get(mark["key"]) == mark["of"] for e in entries):
            axes.plot(
                [place + mark["shift"]],
                [mark["value"]],
                "D",
                color="white",
                markeredgecolor=INK,
                markeredgewidth=1.4,
                markersize=7,
                zorder=5,
                clip_on=False,
                label=None if PAPER in labels else PAPER,
            )
            labels.append(PAPER)


PAPER, PAPER_TASK = "published in the paper", "bgr"


def smoothness(groups: Groups, summary: Mapping[str, Any]) -> Figure | None:
    """SPARC and LDLJ of the instrument's tip; None: no tip has moved."""
    if not any(trials.values(entries, "smoothness", "sparc") for _, entries in groups):
        return None
    figure = blank(3.5)
    for axes, name in zip(figure.subplots(1, 2), ("sparc", "ldlj"), strict=True):
        _boxes(axes, groups, [("tip", EXECUTED, ("smoothness", name))])
        axes.set(title=f"{name.upper()} (closer to zero: smoother)", ylabel=f"{name.upper()} [–]")
    return figure


BOXES = "Box (of three or more): quartiles, line: median, whiskers: 1.5 times the box. "

FIGURES: Figures = {
    "rcm_deviation": (
        "Does the shaft stay in the trocar?",
        f"One dot per episode, first arm. {BOXES}Kinematic: computed from joint"
        " states; true: from the simulator's shaft axis. Logarithmic scale.",
        deviation,
    ),
    "smoothness": (
        "How smooth is the tip's motion?",
        "Executed tip of the first arm at 5 Hz.",
        smoothness,
    ),
}


def grouped(summary: Mapping[str, Any]) -> Groups:
    """Label and episodes of each condition; the label names a law other than ours."""
    groups: list[tuple[str, Entries]] = []
    for condition in summary["conditions"]:
        setting, law = condition["setting"], condition["law"]
        entries = [e for e in summary["episodes"] if (e["setting"], e["law"]) == (setting, law)]
        name = named(setting) if law == "ours" else f"{named(setting)}\nlaw {law}"
        groups.append((name, entries))
    return groups


def _boxes(axes: Axes, groups: Groups, series: Series) -> None:
    """Boxes of all series side by side, for each group."""
    width = 0.7 / len(series)
    counts: list[list[int]] = [[] for _ in groups]
    for j, (label, colour, path) in enumerate(series):
        offset = (j - (len(series) - 1) / 2) * width
        for i, (_, entries) in enumerate(groups):
            values = trials.values(entries, *path)
            counts[i].append(len(values))
            box(axes, i + offset, width, values, colour)
        axes.plot([], [], "o", color=colour, markersize=5, label=label)
    name_groups(axes, [label for label, _ in groups], counts)


FEWEST = 3
"""Values that a box needs; quartiles of fewer say nothing."""


def box(axes: Axes, x: float, width: float, numbers: Sequence[float], colour: str) -> None:
    """One box with its numbers as dots; fewer than ``FEWEST`` are dots alone."""
    if len(numbers) >= FEWEST:
        axes.boxplot(
            numbers,
            positions=[x],
            widths=0.8 * width,
            showfliers=False,
            patch_artist=True,
            boxprops={"facecolor": "white", "edgecolor": colour},
            medianprops={"color": INK, "linewidth": 1.6},
            whiskerprops={"color": colour},
            capprops={"color": colour},
        )
    # The dots are spread evenly over the box in the episodes' order: no random numbers.
    across = x + np.linspace(-0.25, 0.25, len(numbers) + 2)[1:-1] * width
    style = {"markersize": 3.2 if len(numbers) >= FEWEST else 5.0, "alpha": 0.65, "zorder": 3}
    axes.plot(across, numbers, "o", color=colour, clip_on=False, **style)


def name_groups(axes: Axes, labels: Sequence[str], counts: Sequence[Sequence[int]]) -> None:
    """Label the groups at 0, 1, … with the number of values in their boxes, from left to right.

    In smaller type if there are many.
    """
    crowded = len(labels) * len(axes.figure.axes) > 9
    numbers = [dict.fromkeys(each) if len(set(each)) == 1 else each for each in counts]
    full = [
        f"{label}\nn = {', '.join(map(str, each))}"
        for label, each in zip(labels, numbers, strict=True)
    ]
    axes.set_xticks(range(len(labels)), full, fontsize=7 if crowded else None)
    axes.set_xlim(-0.6, len(labels) - 0.4)
    axes.grid(visible=False, axis="x")
