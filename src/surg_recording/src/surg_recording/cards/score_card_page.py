"""The page of score cards: a figure and a table for each task, policies beside each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup
from matplotlib.figure import Figure

from surg_recording.reports import figure_style
from surg_recording.reports.figure_style import EXECUTED, INPUT, blank
from surg_recording.reports.html_page import document, facts, figure_section, note, section, table
from surg_recording.reports.trial_report import interval

Entry = Mapping[str, Any]
_COLUMNS: tuple[tuple[str, str, float], ...] = (
    ("time [s]", "duration_s", 1.0),
    ("RCM mean [mm]", "rcm_mean_m", 1e3),
    ("RCM max [mm]", "rcm_max_m", 1e3),
    ("trocar mean [N]", "trocar_force_mean_n", 1.0),
    ("trocar max [N]", "trocar_force_max_n", 1.0),
    ("tip mean [N]", "tip_force_mean_n", 1.0),
    ("tip max [N]", "tip_force_max_n", 1.0),
    ("path [mm]", "path_m", 1e3),
    ("SPARC", "sparc", 1.0),
)
_HEAD = ("policy", "condition", "success", *(title for title, _, _ in _COLUMNS))
_COUNTS = ("gate refused", "clipped", "late", "controller refused")


def write(cards: Sequence[Entry], folder: Path) -> Path:
    """Write ``report.html`` and its figures; returns the page."""
    tasks = list(dict.fromkeys(cell["task"] for card in cards for cell in card["cells"]))
    sections: list[Markup] = [_policies(cards)]
    for task in tasks:
        rows = [
            (card["policy"]["name"], cell)
            for card in cards
            for cell in card["cells"]
            if cell["task"] == task
        ]
        figures = {task: (f"{task}: how often does it succeed?", _CAPTION, _successes)}
        sections += map(figure_section, figure_style.save_all(figures, folder / "figures", rows))
        sections.append(section("", table((*_HEAD, *_COUNTS), map(_row, rows), range(3, 16))))
        sections.append(_failures(rows))
    file = folder / "report.html"
    file.write_text(document("Score card", sections), encoding="utf-8")
    return file


_CAPTION = "Rate with Wilson's 95 % interval. Grey: blind controls, whose observations say nothing."


def _successes(rows: Sequence[tuple[str, Entry]]) -> Figure:
    figure = blank(1.0 + 0.28 * len(rows))
    axes = figure.subplots()
    for y, (_, cell) in enumerate(rows):
        colour = INPUT if cell["blind"] else EXECUTED
        axes.plot([cell["low"], cell["high"]], [y, y], color=colour, linewidth=3, alpha=0.4)
        axes.plot(cell["k"] / cell["n"], y, "o", color=colour)
    axes.set_yticks(range(len(rows)), [f"{name}, {cell['condition']}" for name, cell in rows])
    axes.invert_yaxis()
    axes.set(xlim=(-0.02, 1.02), xlabel="success [–]")
    return figure


def _row(row: tuple[str, Entry]) -> list[Any]:
    name, cell = row
    means, counts = cell["means"], cell["counts"]
    measured = [None if means[key] is None else scale * means[key] for _, key, scale in _COLUMNS]
    prevented = sum(cell["rejected"].values())
    judged = (prevented, counts["clipped"], counts["late"], counts["refused"])
    return [name, cell["condition"], interval(cell), *measured, *judged]


def _failures(rows: Sequence[tuple[str, Entry]]) -> Markup:
    found = [
        (name, cell["condition"], count, reason)
        for name, cell in rows
        for reason, count in cell["failures"].items()
    ]
    return section("", table(("policy", "condition", "failures", "reason"), found, (2,)))


def _policies(cards: Sequence[Entry]) -> Markup:
    """What each policy is, what it was served, where it was played, and its card's hash."""
    parts: list[Markup] = []
    for card in cards:
        policy = card["policy"]
        served = {s["key"]: s["privileged"] for cell in card["cells"] for s in cell["served"]}
        keys = [f"{key} (ground truth)" if truth else key for key, truth in served.items()]
        alone = "its process reached nothing else" if policy["shut_in"] else "not shut in"
        rows = [
            ("Policy", policy["name"]),
            ("SHA-256 of its files", policy["sha256"]),
            ("It was served", ", ".join(keys) or "nothing"),
            ("Isolation", alone),
            ("Card", f"{card['kind']}, seeds {', '.join(map(str, card['seeds']))}"),
            ("Platform", ", ".join(f"{name} {v}" for name, v in card["platform"].items())),
            ("SHA-256 of the card", card["sha256"]),
        ]
        parts.append(facts(rows))
    return section("Policies", *parts, note("Means over the episodes of a cell. Units are SI."))
