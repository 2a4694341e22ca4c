"""The tables of an evaluation as CSV, LaTeX and Markdown."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from surg_recording.metrics import PRESETS
from surg_recording.reports.evaluation import IDENTITY, METRICS
from surg_recording.reports.html_page import number
from surg_recording.reports.trial_report import interval

_SPREAD = ("n", "min", "q1", "median", "q3", "max", "low", "high")
"""Endings of a metric's columns; ``low``, ``high``: the median's 95 % interval."""
LATEX = (
    *("rcm_kinematic_mean_mm", "rcm_kinematic_max_mm", "rcm_true_max_mm", "sparc", "ldlj"),
    *("path_length_mm", "duration_s", "idle_s"),
)


def save_all(summary: Mapping[str, Any], folder: Path) -> None:
    """Write ``episodes.csv`` and ``conditions.csv``, ``.tex`` and ``.md``."""
    folder.mkdir(parents=True, exist_ok=True)
    _write(folder / "episodes.csv", episodes(summary))
    _write(folder / "conditions.csv", conditions(summary))
    (folder / "conditions.tex").write_text(latex(summary), encoding="utf-8")
    (folder / "conditions.md").write_text(markdown(summary), encoding="utf-8")


def episodes(summary: Mapping[str, Any]) -> list[list[Any]]:
    """A header and a line per episode."""
    preset = summary["preset"]["name"]
    own = (*IDENTITY, "seed", "success", "judged_by", "disagreement", "complete", "folder")
    rows: list[list[Any]] = [[*own, "preset", *(metric.name for metric in METRICS)]]
    for entry in summary["episodes"]:
        numbers = [metric.value(entry, preset) for metric in METRICS]
        rows.append([*(entry[key] for key in own), preset, *numbers])
    return rows


def conditions(summary: Mapping[str, Any]) -> list[list[Any]]:
    """A header, a line per condition, and lines for the reference set and its levels of skill."""
    names = [metric.name for metric in METRICS]
    header = ["condition", *IDENTITY, "preset", "n", "successes", "judged", "success_low"]
    header += ["success_high", *(f"{name}_{part}" for name in names for part in _SPREAD)]
    rows: list[list[Any]] = [header]
    preset = summary["preset"]["name"]
    for label, values in summary["conditions"].items():
        rate = values["success_rate"] or {}
        row = [label, *(values[key] for key in IDENTITY), preset, values["n"]]
        row += [rate.get(key) for key in ("k", "n", "low", "high")]
        rows.append(row + [value for name in names for value in _parts(values[name])])
    for label, values in _references(summary):
        row = [label, *[None] * len(IDENTITY), preset, values["trials"], *[None] * 4]
        rows.append(row + [value for name in names for value in _parts(values.get(name))])
    return rows


def latex(summary: Mapping[str, Any]) -> str:
    """A tabular of medians with quartiles and counts; needs no package."""
    shown = [metric for metric in METRICS if metric.name in LATEX]
    preset = PRESETS[summary["preset"]["name"]]
    sources = sorted({values["source"] for values in summary["conditions"].values()})
    lines = [
        f"% {' and '.join(sources)}; median [quartiles] (number of values);"
        " success with Wilson's 95 % interval",
        f"% smoothness: {preset.label()}",
        rf"\begin{{tabular}}{{lrr{'r' * len(shown)}}}",
        r"\hline",
        " & ".join(["Condition", "$n$", r"success [\%]", *(escape(m.heading) for m in shown)])
        + r" \\",
        r"\hline",
    ]
    for label, values in summary["conditions"].items():
        cells = [escape(label), str(values["n"]), _rate(values["success_rate"])]
        lines.append(" & ".join(cells + [_latex(values[m.name]) for m in shown]) + r" \\")
    references = _references(summary)
    if references:
        lines.append(r"\hline")
    for label, values in references:
        cells = [escape(label), str(values["trials"]), "--"]
        lines.append(" & ".join(cells + [_latex(values.get(m.name)) for m in shown]) + r" \\")
    return "\n".join([*lines, r"\hline", r"\end{tabular}"]) + "\n"


def markdown(summary: Mapping[str, Any]) -> str:
    """A line per metric, a column per condition: median [quartiles], 95 % interval, count."""
    columns = [*summary["conditions"].items(), *_references(summary)]
    rows = [["", *(label for label, _ in columns)], ["---"] * (1 + len(columns))]
    rows.append(["episodes or trials", *(str(f.get("n", f.get("trials"))) for _, f in columns)])
    rates = [values.get("success_rate") for _, values in columns]
    rows.append(["success", *(interval(rate) if rate else "–" for rate in rates)])
    for metric in METRICS:
        cells = ["; ".join(filter(None, spread_words(f.get(metric.name)))) for _, f in columns]
        rows.append([metric.heading, *cells])
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def escape(text: str) -> str:
    """Text for LaTeX."""
    special = {
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        **{character: "\\" + character for character in "&%$#_{}"},
    }
    return "".join(special.get(character, character) for character in text)


def _latex(spread: Mapping[str, Any] | None) -> str:
    if not spread or not spread["n"]:
        return "--"
    first, third = map(number, spread["quartiles"])
    return f"${number(spread['median'])}$ $[{first},\\,{third}]$ $({spread['n']})$"


def spread_words(spread: Mapping[str, Any] | None) -> tuple[str, str]:
    """Median with quartiles; the interval of the median and the count of values."""
    if not spread or not spread["n"]:
        return "–", ""
    first, third = map(number, spread["quartiles"])
    interval = " to ".join(map(number, spread["interval"] or ()))
    sure = ", ".join(filter(None, (interval, f"n = {spread['n']}")))
    return f"{number(spread['median'])} [{first}, {third}]", sure


def _rate(rate: Mapping[str, Any] | None) -> str:
    if not rate:
        return "--"
    share, low, high = (100.0 * x for x in (rate["k"] / rate["n"], rate["low"], rate["high"]))
    return f"${share:.0f}$ $[{low:.0f},\\,{high:.0f}]$"


def _references(summary: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    compared = summary["reference"]
    if compared is None:
        return []
    name = compared["name"]
    levels = [(f"{name}, {skill}", level) for skill, level in compared["by_skill"].items()]
    return [(name, compared), *levels]


def _parts(spread: Mapping[str, Any] | None) -> Sequence[Any]:
    """The values under ``_SPREAD``."""
    if not spread or not spread["n"]:
        return [0, *[None] * (len(_SPREAD) - 1)]
    (first, third), (low, high) = spread["quartiles"], spread["interval"] or (None, None)
    return [spread["n"], spread["min"], first, spread["median"], third, spread["max"], low, high]


def _write(path: Path, rows: Sequence[Sequence[Any]]) -> None:
    with open(path, "w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)
