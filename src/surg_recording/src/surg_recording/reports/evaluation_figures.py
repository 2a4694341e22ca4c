"""The figures of an evaluation, by condition."""

from __future__ import annotations

import dataclasses
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from surg_recording.metrics import PRESETS
from surg_recording.metrics.paper_values import PAPER_VALUES
from surg_recording.reports import evaluation, trial_figures
from surg_recording.reports.figure_style import (
    EXECUTED,
    FOOTNOTE,
    GRID,
    INK,
    INPUT,
    Drawn,
    Figures,
    blank,
    save_all,
)
from surg_recording.reports.terms import named


def deviation(summary: Mapping[str, Any]) -> Figure | None:
    """Mean and maximum of the RCM deviation of each episode; None: none has one."""
    groups, marks = _groups(summary), [mark for mark in _paper(summary) if mark["metric"] == "rcm"]
    conditions = {"conditions": list(summary["conditions"].values()), "paper": marks}
    figure = trial_figures.deviation(groups, conditions)
    if figure is not None:
        _footnote(figure, origin(summary))
    return figure


def smoothness(summary: Mapping[str, Any]) -> Figure:
    """SPARC and LDLJ of each episode's tip beside the reference set."""
    preset = PRESETS[summary["preset"]["name"]]
    groups, others = _groups(summary), _references(summary)
    figure = blank(3.9)
    for axes, name in zip(figure.subplots(1, 2), ("sparc", "ldlj"), strict=True):
        metric = _boxes(axes, name, [*groups, *others], summary, own=len(groups))
        if groups and others:
            axes.axvline(len(groups) - 0.5, color=GRID, linewidth=1.6)
        axes.set(title=f"{metric.title} (closer to zero: smoother)", ylabel=f"{metric.title} [–]")
        axes.margins(y=0.1)
        for mark in _paper(summary):
            if mark["metric"] == name:
                trial_figures.paper_mark(axes, mark, [*groups, *others])
        if axes.get_legend_handles_labels()[0]:
            axes.legend(loc="best", fontsize=8)
    _footnote(figure, origin(summary), preset.label())
    return figure


def effort(summary: Mapping[str, Any]) -> Figure:
    """Path length, duration and idle time of each episode."""
    groups, figure = _groups(summary), blank(3.5)
    names = ("path_length_mm", "duration_s", "idle_s")
    for axes, name in zip(figure.subplots(1, len(names)), names, strict=True):
        metric = _boxes(axes, name, groups, summary, own=len(groups))
        axes.set(title=metric.title.capitalize(), ylabel=metric.heading)
        axes.set_ylim(0, 1.05 * axes.get_ylim()[1])
    _footnote(figure, origin(summary))
    return figure


def _footnote(figure: Figure, *lines: str) -> None:
    """Small print below a figure, in lines that fit it."""
    wrapped = [each for line in lines for each in textwrap.wrap(line, FOOTNOTE)]
    figure.supxlabel("\n".join(wrapped), fontsize=8.5, color=INK)


def _paper(summary: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    """The published values to mark: those asked for, smoothness only of the paper's preset."""
    if not summary.get("paper_values"):
        return ()
    ours = summary["preset"]["name"] == "paper"
    return [mark for mark in PAPER_VALUES if ours or mark["metric"] == "rcm"]


def _boxes(
    axes: Axes, name: str, groups: trial_figures.Groups, summary: Mapping[str, Any], own: int
) -> evaluation.Metric:
    """Boxes of a metric, which is returned; groups after the first ``own`` are references."""
    metric = next(m for m in evaluation.METRICS if m.name == name)
    counts = []
    for i, (_, entries) in enumerate(groups):
        values = metric.values(entries, summary["preset"]["name"])
        counts.append([len(values)])
        trial_figures.box(axes, i, 0.6, values, EXECUTED if i < own else INPUT)
    trial_figures.name_groups(axes, [label for label, _ in groups], counts)
    return metric


FIGURES: Figures = {
    "rcm_deviation": (
        "Does the shaft stay in the trocar?",
        f"One dot per episode, first arm. {trial_figures.BOXES}Kinematic: from joint states and"
        " calibration, the paper's metric; true: from the simulator's shaft axis. Logarithmic"
        " scale.",
        deviation,
    ),
    "smoothness": (
        "How smooth is the tip's motion?",
        "One dot per episode or trial. All values are of one preset; values of another preset, or"
        " of another task, are no comparison of skill.",
        smoothness,
    ),
    "effort": (
        "How far, how long, how hesitant?",
        "Path of the tip low-passed at 3 Hz. Idle: pauses of at least 0.5 s below 1 mm/s.",
        effort,
    ),
}


def save_figures(summary: Mapping[str, Any], folder: Path) -> list[Drawn]:
    """Draw the figures as PNG and SVG files; without episodes only that of the reference set."""
    figures = FIGURES if summary["conditions"] else {"smoothness": FIGURES["smoothness"]}
    drawn = save_all(figures, folder, summary, formats=("png", "svg"))
    return [dataclasses.replace(d, caption=f"{d.caption} {origin(summary)}.") for d in drawn]


def origin(summary: Mapping[str, Any]) -> str:
    """Source (simulation or real), and whatever else all conditions have in common."""
    conditions = list(summary["conditions"].values())
    if not conditions:
        return "No episode"
    keys = ("source", "title", "robot", "law")
    common = [_common(conditions, key) for key in keys]
    common[1] = common[1] or _common(conditions, "task")
    common[1], common[2] = (value and named(value) for value in common[1:3])
    sources = {condition["source"] for condition in conditions}
    if len(sources) > 1:
        common[0] = "simulation and real, see the labels"
    common[3] = common[3] and f"law {common[3]}"
    text = ", ".join(str(value) for value in common if value)
    return text[:1].upper() + text[1:]


def _common(conditions: Sequence[Mapping[str, Any]], key: str) -> Any:
    values = {condition[key] for condition in conditions}
    return values.pop() if len(values) == 1 else None


def _groups(summary: Mapping[str, Any]) -> trial_figures.Groups:
    """Episodes of each condition under its label, one part per line."""
    return [
        (label.replace(", ", "\n"), entries)
        for label, entries in evaluation.grouped(summary["episodes"], named).items()
    ]


def _references(summary: Mapping[str, Any]) -> trial_figures.Groups:
    """The reference set; its experts also on their own, if not all are experts."""
    compared = summary["reference"]
    if compared is None:
        return []
    each = compared["each"]
    name = textwrap.fill(str(compared["name"]), 11, break_long_words=False)
    groups = [(name, each)]
    experts = [trial for trial in each if trial["skill"] == "expert"]
    if 0 < len(experts) < len(each):
        groups.append((f"{name}\nexperts", experts))
    return groups
