"""The report of many episodes: ``summary.json``, ``figures/*.png``, ``report.html``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup

from surg_recording.episode.finishing import write_json
from surg_recording.episode.verdicts import ABORTED, CRASHED, UNJUDGED
from surg_recording.reports import failure_figure, trial_figures
from surg_recording.reports.figure_style import save_all
from surg_recording.reports.html_page import (
    MET,
    MISSED,
    SUCCESS,
    bullets,
    code,
    definitions,
    document,
    figure_section,
    film_section,
    note,
    number,
    section,
    table,
)
from surg_recording.reports.terms import named

_TERMS = (
    *("Success", "95 % interval", "Window", "Kinematic RCM deviation", "True RCM deviation"),
    *("Bound", "State hash"),
)


def write(summary: Mapping[str, Any], folder: Path) -> None:
    """Write ``summary.json``, ``figures/`` and ``report.html`` of a run; may raise OSError.

    ``summary`` is from ``trials.summarise``; an episode's ``folder`` is relative to the run's.
    """
    write_json(folder / "summary.json", summary)
    drawn = []
    if summary["episodes"]:
        groups = trial_figures.grouped(summary)
        drawn = save_all(trial_figures.FIGURES, folder / "figures", groups, summary)
    title = f"{named(summary.get('title') or summary['task'])}: {named(summary['robot'])}"
    sections = [
        film_section(
            folder, "Endoscope as recorded, and the room drawn from the recorded joint positions."
        ),
        _verdict(summary),
        *map(figure_section, drawn),
        *_failures(summary["episodes"], folder),
        _conditions(summary["conditions"]),
        _episodes(summary["episodes"]),
        definitions(*_TERMS),
    ]
    (folder / "report.html").write_text(document(title, sections), encoding="utf-8")


def interval(rate: Mapping[str, Any]) -> str:
    """A success rate with its interval, in words."""
    if not rate["n"]:
        return "0 of 0"
    low, high = 100.0 * rate["low"], 100.0 * rate["high"]
    return f"{rate['k']} of {rate['n']} (95 % interval {low:.1f} to {high:.1f} %)"


def _verdict(summary: Mapping[str, Any]) -> Markup:
    rate, counts = summary["success_rate"], Counter(e["outcome"] for e in summary["episodes"])
    others = [f"{counts[word]} {word}" for word in (ABORTED, CRASHED, UNJUDGED) if counts[word]]
    good = "ok" if rate["k"] else None  # that nothing succeeded is a result, and no good one
    return section(
        ", ".join((f"{interval(rate)} succeeded", *others)),
        "Not every episode was played to its end:" if summary["reasons"] else "",
        bullets(summary["reasons"]),
        verdict=good if summary["ok"] else "bad",
    )


def _failures(episodes: Sequence[Mapping[str, Any]], folder: Path) -> Iterator[Markup]:
    """Why did it fail? What happened last in each episode without a success, and its time."""
    for place, entry in enumerate(episodes):
        if not entry["success"]:
            drawn = failure_figure.save(entry, folder, place)
            missing = note("Nothing that could be drawn was recorded.")
            title = f"Episode {place}: {failure_figure.last_words(entry)}"
            yield figure_section(drawn) if drawn else section(title, missing)


def _conditions(conditions: Sequence[Mapping[str, Any]]) -> Markup:
    head = (
        *("Setting", "Law", "Success", "RCM mean", "RCM max", "true RCM max"),
        *("trocar force max", "trocar displacement max", "Bounds"),
    )
    rows = [
        (
            *(c["setting"], c["law"], interval(c["success_rate"])),
            *map(_median_max, (c["rcm_kinematic_mm"]["mean"], c["rcm_kinematic_mm"]["max"])),
            *map(_median_max, (c["rcm_true_mm"]["max"], c["trocar_force_n"])),
            _median_max(c["trocar_displacement_mm"]),
            Markup("<br>").join(map(_bound, c["bounds"])),
        )
        for c in conditions
    ]
    return section(
        "By condition",
        note(
            "Median and worst over the episodes; deviations and displacement in mm, force in N;"
            " first arm."
        ),
        table(head, rows, right=range(3, 8)),
    )


def _bound(bound: Mapping[str, Any]) -> Markup:
    missed = Markup("{} ({})").format(MISSED, number(bound["worst"]))
    mark = "not measured" if bound["worst"] is None else MET if bound["met"] else missed
    return Markup("{} &lt; {:g}: {}").format(bound["metric"], bound["value"], mark)


def _median_max(spread: Mapping[str, Any]) -> str:
    return f"{number(spread['median'])} / {number(spread['max'])}"


def _episodes(episodes: Sequence[Mapping[str, Any]]) -> Markup:
    head = ("", "Seed", "Setting", "Law", "End", "Duration [s]", "RCM mean [mm]", "RCM max [mm]")
    rows = []
    for i, e in enumerate(episodes):
        folder = e.get("folder")
        kinematic, true = e["rcm_kinematic_mm"] or {}, e["rcm_true_mm"] or {}
        rows.append(
            (
                Markup("<a href='{}/report.html'>{}</a>").format(folder, i) if folder else i,
                *(e["seed"], e["setting"], e["law"]),
                SUCCESS if e["success"] else f"{e['outcome']}: {e['failure_reason']}",
                *(e["duration_s"], kinematic.get("mean"), kinematic.get("max"), true.get("max")),
                code((e["state_hash"] or "–")[:12]),
            )
        )
    return section(
        "Every episode", table((*head, "true max [mm]", "State hash"), rows, right=range(5, 9))
    )
