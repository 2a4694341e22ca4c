"""Box plots of many episodes: a box per condition, a dot per episode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from surg_recording.reports import trials
from surg_recording.reports.figure_style import EXECUTED, FAINT, INK, LIMIT, TRUE, Figures, blank

Entries = Sequence[Mapping[str, Any]]
Groups = Sequence[tuple[str, Entries]]
"""Label and episodes of each condition."""
Series = Sequence[tuple[str, str, tuple[str, ...]]]
"""Label, colour, and path of the number in an episode, of each box in a group."""


def deviation(groups: Groups, summary: Mapping[str, Any]) -> Figure:
    """Mean and maximum of the RCM deviation of each episode."""
    figure = blank(4.2)
    for axes, metric in zip(figure.subplots(1, 2), ("mean", "max"), strict=True):
        series = [
            ("kinematic", EXECUTED, ("rcm_kinematic_mm", metric)),
            ("true", TRUE, ("rcm_true_mm", metric)),
        ]
        if not any(trials.values(entries, *series[1][2]) for _, entries in groups):
            series.pop()  # no simulator, no truth
        _boxes(axes, groups, series)
        for i, condition in enumerate(summary["conditions"]):
            for bound in condition.get("bounds", ()):
                if bound["metric"] == metric:
                    # Over the kinematic box only: the other one is not held against it.
                    axes.plot([i - 0.4, i - 0.02], [bound["value"]] * 2, "--", color=LIMIT, lw=1.2)
        axes.set_yscale("log")
        axes.margins(y=0.12)
        axes.yaxis.set_major_locator(matplotlib.ticker.LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(matplotlib.ticker.FuncFormatter(lambda y, _: f"{y:g}"))
        axes.yaxis.set_minor_formatter(matplotlib.ticker.NullFormatter())
        axes.set(title=f"RCM deviation, {metric} of each episode", ylabel="mm")
    if any(condition.get("bounds") for condition in summary["conditions"]):
        axes.plot([], [], "--", color=LIMIT, lw=1.0, label="bound (kinematic)")
    first, (low, high) = figure.axes[0], figure.axes[0].get_ylim()
    first.set_ylim(low, high * (high / low) ** 0.15)  # logarithmic: room for the legend
    handles, labels = axes.get_legend_handles_labels()
    first.legend(handles, labels, loc="upper center", ncols=3, columnspacing=1.0, fontsize=8)
    return figure


def smoothness(groups: Groups, summary: Mapping[str, Any]) -> Figure:
    """SPARC and LDLJ of the instrument's tip."""
    figure = blank(3.5)
    for axes, name in zip(figure.subplots(1, 2), ("sparc", "ldlj"), strict=True):
        _boxes(axes, groups, [("tip", EXECUTED, ("smoothness", name))])
        axes.set(title=f"{name.upper()} (closer to zero: smoother)", ylabel=name.upper())
    return figure


def load(groups: Groups, summary: Mapping[str, Any]) -> Figure:
    """Maximum force on the trocar, its maximum displacement, and the duration of each episode."""
    figure = blank(3.5)
    panels = (
        ("Trocar force, max", "N", ("trocar", "force_n", "max"), TRUE),
        ("Trocar displacement, max", "mm", ("trocar", "displacement_mm", "max"), TRUE),
        ("Duration", "s simulated", ("duration_s",), FAINT),
    )
    for axes, (title, unit, path, colour) in zip(figure.subplots(1, 3), panels, strict=True):
        _boxes(axes, groups, [(title, colour, path)])
        axes.set(title=title, ylabel=unit)
        axes.set_ylim(bottom=0)
    return figure


FIGURES: Figures = {
    "rcm_deviation": (
        "Does the shaft stay in the trocar?",
        "One dot per episode, first arm. Box: quartiles, line: median, whiskers: 1.5 times the"
        " box. Kinematic: computed from joint states; true: from the simulator's shaft axis."
        " Logarithmic scale.",
        deviation,
    ),
    "smoothness": (
        "How smooth is the tip's motion?",
        "Executed tip of the first arm at 5 Hz.",
        smoothness,
    ),
    "load": (
        "What load does the wall bear, and how long does an episode take?",
        "Of the first arm, from the simulator's truth.",
        load,
    ),
}


def grouped(summary: Mapping[str, Any]) -> Groups:
    """Label and episodes of each condition; the label names a law other than ours."""
    groups: list[tuple[str, Entries]] = []
    for condition in summary["conditions"]:
        setting, law = condition["setting"], condition["law"]
        entries = [e for e in summary["episodes"] if (e["setting"], e["law"]) == (setting, law)]
        name = setting if law == "ours" else f"{setting}\n{law}"
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


def box(axes: Axes, x: float, width: float, numbers: Sequence[float], colour: str) -> None:
    """One box with its numbers as dots; nothing without numbers."""
    if not numbers:
        return
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
    axes.plot(across, numbers, "o", color=colour, markersize=3.2, alpha=0.65, zorder=3)


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
