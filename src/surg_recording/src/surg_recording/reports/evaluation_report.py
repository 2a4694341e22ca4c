"""The report of an evaluation: ``summary.json``, ``figures/``, ``tables/``, ``report.html``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from surg_recording.episode.finishing import clean_json, write_json
from surg_recording.metrics import PRESETS
from surg_recording.reports import evaluation_figures, evaluation_tables
from surg_recording.reports.evaluation import METRICS
from surg_recording.reports.html_page import definitions, document, figure_section, number, text
from surg_recording.reports.trial_report import interval

_DEFINITIONS = (
    (
        "Condition",
        "Episodes with the same task, setting, robot, control law and source (simulation or real)."
        " A label names what tells the conditions apart.",
    ),
    (
        "RCM deviation, kinematic",
        "Distance from the commanded pivot to the infinite shaft line, from joint states and"
        " calibration, at every control cycle of the commanded window. The paper's metric; it"
        " does not include calibration errors.",
    ),
    (
        "RCM deviation, true",
        "Distance from the unloaded trocar point to the simulator's shaft axis.",
    ),
    (
        "SPARC, LDLJ",
        "Spectral arc length and log dimensionless jerk of the executed tip motion at 5 Hz, by the"
        " one preset named; closer to zero is smoother. docs/guide/evaluation.md has the formulas.",
    ),
    (
        "Path length, duration, idle time",
        "Of the executed tip in the commanded window; path low-passed at 3 Hz; idle: pauses of at"
        " least 0.5 s below 1 mm/s.",
    ),
    (
        "Median [quartiles], interval",
        "Over the episodes. The 95 % interval of the median is between two of the values (order"
        " statistics, no distribution assumed) and needs 6 of them. Success: Wilson's score"
        " interval.",
    ),
)


def write(summary: Mapping[str, Any], folder: Path) -> None:
    """Write everything.

    Args:
        summary: Made by ``evaluation.summarise``.
        folder: Where it goes; made where missing.

    Raises:
        OSError: The folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "summary.json", clean_json(dict(summary)))
    evaluation_tables.save_all(summary, folder / "tables")
    drawn = []
    if summary["conditions"]:
        drawn = evaluation_figures.save_all(summary, folder / "figures")
    title = "Evaluation of recorded episodes"
    sections = [
        f"<h1>{text(title)}</h1>",
        _what(summary),
        _conditions(summary),
        *map(figure_section, drawn),
        _reference(summary["reference"]),
        _episodes(summary),
        _left_out(summary["left_out"]),
        definitions(_DEFINITIONS),
    ]
    page = document(title, [section for section in sections if section])
    (folder / "report.html").write_text(page, encoding="utf-8")


def _what(summary: Mapping[str, Any]) -> str:
    conditions = summary["conditions"]
    rows = [
        ("Episodes", len(summary["episodes"])),
        ("Conditions", len(conditions)),
        ("Left out", len(summary["left_out"])),
        ("Data", evaluation_figures.origin(summary) if conditions else None),
        ("Smoothness", PRESETS[summary["preset"]["name"]].label()),
        ("Reference", (summary["reference"] or {}).get("source")),
    ]
    cells = "".join(f"<tr><th>{name}</th><td>{text(value)}</td></tr>" for name, value in rows)
    return f"<section><h2>What was evaluated</h2><table>{cells}</table></section>"


def _conditions(summary: Mapping[str, Any]) -> str:
    conditions = summary["conditions"]
    if not conditions:
        return "<section class='verdict bad'><h2>No episode could be evaluated</h2></section>"
    heads = "".join(f"<th class='n'>{text(label)}</th>" for label in conditions)
    counts = "".join(f"<td class='n'>{found['n']}</td>" for found in conditions.values())
    rates = "".join(f"<td class='n'>{_rate(f['success_rate'])}</td>" for f in conditions.values())
    rows = [f"<tr><td>episodes</td>{counts}</tr>", f"<tr><td>success</td>{rates}</tr>"]
    for metric in METRICS:
        name = f"{metric.title} [{metric.unit}]" if metric.unit else metric.title
        cells = "".join(
            f"<td class='n'>{_spread(f[metric.name])}</td>" for f in conditions.values()
        )
        rows.append(f"<tr><td>{text(name)}</td>{cells}</tr>")
    return (
        "<section><h2>By condition</h2><p class='faint small'>Median [quartiles] over the"
        " episodes; below it the 95 % interval of the median. First arm.</p>"
        f"<table class='small'><tr><th></th>{heads}</tr>{''.join(rows)}</table></section>"
    )


def _rate(rate: Mapping[str, Any] | None) -> str:
    return "not judged" if rate is None else text(interval(rate))


def _spread(found: Mapping[str, Any]) -> str:
    if not found["n"]:
        return "–"
    first, third = found["quartiles"]
    words = f"{number(found['median'])} [{number(first)}, {number(third)}]"
    if found["interval"] is None:
        return words
    low, high = found["interval"]
    return f"{words}<br><span class='faint'>{number(low)} to {number(high)}</span>"


def _reference(compared: Mapping[str, Any] | None) -> str:
    if compared is None:
        return ""
    groups = [("all", compared), *compared["by_skill"].items()]
    rows = "".join(
        f"<tr><td>{text(name)}</td><td class='n'>{found['trials']}</td>"
        + "".join(f"<td class='n'>{_spread(found[key])}</td>" for key in _OF_A_REFERENCE)
        + "</tr>"
        for name, found in groups
    )
    left_out = "".join(f"<li>{text(reason)}</li>" for reason in compared["left_out"])
    heads = "".join(f"<th class='n'>{title}</th>" for title in _OF_A_REFERENCE.values())
    return (
        f"<section><h2>Reference: {text(compared['name'])}</h2><p class='faint small'>"
        f"{text(compared['source'])}; through the same computation as the episodes.</p>"
        f"<table class='small'><tr><th></th><th class='n'>Trials</th>{heads}</tr>{rows}</table>"
        + (f"<p>Left out:</p><ul class='small'>{left_out}</ul>" if left_out else "")
        + "</section>"
    )


_OF_A_REFERENCE = {
    "sparc": "SPARC",
    "ldlj": "LDLJ",
    "path_length_mm": "path length [mm]",
    "duration_s": "duration [s]",
    "idle_s": "idle time [s]",
}


def _episodes(summary: Mapping[str, Any]) -> str:
    preset = summary["preset"]["name"]
    shown = [m for m in METRICS if m.name in evaluation_tables.LATEX]
    rows = []
    for entry in summary["episodes"]:
        end = {True: "success", False: f"failed: {entry['failure_reason']}", None: "not judged"}
        mark = "" if entry["complete"] else f"; incomplete: {entry['problem']}"
        numbers = "".join(
            f"<td class='n'>{number(next(iter(m.values([entry], preset)), None))}</td>"
            for m in shown
        )
        rows.append(
            f"<tr><td><code>{text(entry['folder'])}</code></td>"
            f"<td>{text(entry['setting'])}</td><td>{text(entry['robot'])}</td>"
            f"<td>{text(entry['law'])}</td><td>{text(end[entry['success']] + mark)}</td>"
            f"{numbers}</tr>"
        )
    heads = "".join(
        f"<th class='n'>{text(m.title)}{f' [{m.unit}]' if m.unit else ''}</th>" for m in shown
    )
    return (
        "<section><h2>Every episode</h2><details><summary>Show</summary><table class='small'><tr>"
        f"<th>Folder</th><th>Setting</th><th>Robot</th><th>Law</th><th>End</th>{heads}</tr>"
        f"{''.join(rows)}</table></details></section>"
    )


def _left_out(left_out: Sequence[Mapping[str, Any]]) -> str:
    if not left_out:
        return ""
    rows = "".join(f"<li>{text(each['reason'])}</li>" for each in left_out)
    return f"<section><h2>Left out</h2><ul class='small'>{rows}</ul></section>"
