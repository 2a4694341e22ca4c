"""The report of an evaluation: ``summary.json``, ``figures/``, ``tables/``, ``report.html``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup

from surg_recording.episode.finishing import write_json
from surg_recording.metrics import PRESETS
from surg_recording.reports import evaluation, evaluation_figures, evaluation_tables
from surg_recording.reports.evaluation import METRICS
from surg_recording.reports.html_page import (
    bullets,
    code,
    definitions,
    document,
    facts,
    figure_section,
    folded,
    note,
    section,
    table,
)
from surg_recording.reports.trial_report import interval

_TERMS = (
    *("Condition", "Window", "Kinematic RCM deviation", "True RCM deviation", "SPARC, LDLJ"),
    *("Path length", "Idle time", "Median [quartiles], interval", "95 % interval"),
)
_REFERENCE_METRICS = {
    "sparc": "SPARC",
    "ldlj": "LDLJ",
    "path_length_mm": "path length [mm]",
    "duration_s": "duration [s]",
    "idle_s": "idle time [s]",
}


def write(summary: Mapping[str, Any], folder: Path) -> None:
    """Write summary, tables, figures and page of an evaluation; may raise OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "summary.json", summary)
    evaluation_tables.save_all(summary, folder / "tables")
    drawn = []
    if summary["conditions"] or summary["reference"]:
        drawn = evaluation_figures.save_figures(summary, folder / "figures")
    title = "Evaluation of recorded episodes"
    left_out = [each["reason"] for each in summary["left_out"]]
    remarks = evaluation.remarks(summary["episodes"])
    sections = [
        _what_was_evaluated(summary),
        _conditions(summary),
        *map(figure_section, drawn),
        _reference(summary["reference"]),
        _episodes(summary),
        section("Remarks", bullets(remarks)) if remarks else "",
        section("Left out", bullets(left_out)) if left_out else "",
        definitions(*_TERMS),
    ]
    (folder / "report.html").write_text(document(title, filter(None, sections)), encoding="utf-8")


def _what_was_evaluated(summary: Mapping[str, Any]) -> Markup:
    conditions = summary["conditions"]
    rows = [
        ("Episodes", len(summary["episodes"])),
        ("Conditions", len(conditions)),
        ("Left out", len(summary["left_out"])),
        ("Data", evaluation_figures.origin(summary) if conditions else None),
        ("Smoothness", PRESETS[summary["preset"]["name"]].label()),
        ("Reference", (summary["reference"] or {}).get("source")),
    ]
    return section("What was evaluated", facts(rows))


def _conditions(summary: Mapping[str, Any]) -> Markup:
    columns = summary["conditions"].values()
    if not columns and not summary["left_out"]:
        return Markup()  # the reference alone was asked for
    if not columns:
        return section("No episode could be evaluated", verdict="bad")
    rates = [c["success_rate"] for c in columns]
    rows = [
        ("episodes", *(c["n"] for c in columns)),
        ("success", *("not judged" if rate is None else interval(rate) for rate in rates)),
        *((m.heading, *(_spread(c[m.name]) for c in columns)) for m in METRICS),
    ]
    return section(
        "By condition",
        note(
            "Median [quartiles] over the episodes; below it the 95 % interval of the median and"
            " the number of values. First arm."
        ),
        table(("", *summary["conditions"]), rows, right=range(1, len(columns) + 1)),
    )


def _spread(spread: Mapping[str, Any]) -> str:
    median, bounds = evaluation_tables.spread_words(spread)
    both = Markup("{}<br><span class='faint'>{}</span>")
    return both.format(median, bounds) if bounds else median


def _reference(compared: Mapping[str, Any] | None) -> Markup:
    if compared is None:
        return Markup()
    rows = [
        (name, level["trials"], *(_spread(level[key]) for key in _REFERENCE_METRICS))
        for name, level in {"all": compared, **compared["by_skill"]}.items()
    ]
    left_out = bullets(compared["left_out"])
    return section(
        f"Reference: {compared['name']}",
        note(f"{compared['source']}; through the same computation as the episodes."),
        table(("", "Trials", *_REFERENCE_METRICS.values()), rows, right=range(1, 7)),
        *(["Left out:", left_out] if left_out else []),
    )


def _episodes(summary: Mapping[str, Any]) -> Markup:
    shown = [m for m in METRICS if m.name in evaluation_tables.LATEX]
    rows = []
    for entry in summary["episodes"]:
        end = ": ".join(filter(None, (entry["outcome"], entry["failure_reason"])))
        mark = f" ({entry['judged_by']})" if entry.get("judged_by") else ""
        if entry.get("disagreement"):
            mark += f"; verdicts disagree: {entry['disagreement']}"
        mark += "" if entry["complete"] else f"; incomplete: {entry['problem']}"
        rows.append(
            (
                code(entry["folder"]),
                *(entry[key] for key in ("setting", "robot", "law")),
                end + mark,
                *(m.value(entry, summary["preset"]["name"]) for m in shown),
            )
        )
    head = ("Folder", "Setting", "Robot", "Law", "End", *(m.heading for m in shown))
    return section("Every episode", folded("Show", table(head, rows, right=range(5, len(head)))))
