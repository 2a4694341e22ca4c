"""The report of a learned policy: ``summary.json``, ``figures/*.png``, ``report.html``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup

from surg_recording.episode.finishing import write_json
from surg_recording.reports import trial_figures
from surg_recording.reports.figure_style import save_all
from surg_recording.reports.html_page import (
    SUCCESS,
    bullets,
    document,
    facts,
    figure_section,
    film_section,
    note,
    number,
    section,
    table,
)
from surg_recording.reports.trial_report import interval

Entry = Mapping[str, Any]
FILMS = {False: "film_failed.mp4", True: "film_succeeded.mp4"}
"""Films of the first failed and the first successful roll-out, by success."""

_FIGURES = {
    "rcm_deviation": (
        "Does the shaft stay in the trocar?",
        "One dot per episode. Demonstrations of the scripted expert, roll-outs of the policy.",
        trial_figures.deviation,
    ),
    "smoothness": (
        "How smooth is the tip's motion?",
        "Executed tip at 5 Hz, preset reference.",
        trial_figures.smoothness,
    ),
}


def write(
    summary: Mapping[str, Any], played: Sequence[Entry], shown: Sequence[Entry], folder: Path
) -> None:
    """Write ``summary.json``, ``figures/`` and ``report.html``; may raise OSError.

    ``played`` and ``shown`` are the entries of roll-outs and demonstrations.
    """
    write_json(folder / "summary.json", summary)
    groups = [
        (f"demonstrations\nn = {len(shown)}", shown),
        (f"roll-outs\nn = {len(played)}", played),
    ]
    no_bounds: Mapping[str, Any] = {"conditions": []}
    drawn = save_all(_FIGURES, folder / "figures", groups, no_bounds)
    title = f"{summary['title']}: a learned policy"
    sections = [
        *_films(summary["rollouts"], folder),
        section(
            f"{interval(summary['success_rate'])} succeeded",
            bullets(summary["reasons"]),
            verdict="ok" if summary["ok"] else "bad",
        ),
        *map(figure_section, drawn),
        _what_was_done(summary),
        _rollouts(summary["rollouts"]),
        _unsafe(summary),
    ]
    (folder / "report.html").write_text(document(title, sections), encoding="utf-8")


def _films(rollouts: Sequence[Entry], folder: Path) -> list[Markup]:
    """The first failed and the first successful roll-out, or that there was none."""
    played = [entry for entry in rollouts if entry["played"]]
    sections = []
    for wanted, name in FILMS.items():
        word = "successful" if wanted else "failed"
        first = next((entry for entry in played if bool(entry["success"]) is wanted), None)
        if first is None:
            none = "succeeded" if wanted else "failed"
            sections.append(section(f"No roll-out {none}", note("So there is no film of one.")))
            continue
        why = "" if wanted else f": {first['reason']}"
        caption = (
            f"The first {word} roll-out, seed {first['seed']}{why}. Endoscope as recorded, and"
        )
        caption += " the room drawn from the recorded joint positions."
        missing = note(f"There is no film of the first {word} roll-out, seed {first['seed']}{why}.")
        sections.append(film_section(folder, caption, name) or section("", missing))
    return sections


def _what_was_done(summary: Entry) -> Markup:
    demonstrations = f"{summary['demonstrations']}, {summary['demonstrations_success']} solved"
    rows = [
        ("Task, setting, robot", f"{summary['task']}, {summary['setting']}, {summary['robot']}"),
        ("Demonstrations", demonstrations),
        ("Observation", ", ".join(summary["observation"])),
        ("Ground truth that no robot can measure", ", ".join(summary["privileged"]) or "none"),
        ("Policy", summary["policy"]),
        ("RCM deviation of the roll-outs, largest [mm]", summary["rcm_max_mm"]["max"]),
        ("Rejected, clipped, late actions", ", ".join(number(summary[n]) for n in _COUNTS)),
        ("Age of the observation at execution [ms]", _times(summary["obs_age_ms"])),
        ("Round trip [ms]", _times(summary["round_trip_ms"])),
        *((f"Stage {name} [s]", f"{s:.0f}") for name, s in summary["stages_s"].items()),
    ]
    return section("What was done", facts(rows))


_COUNTS = ("rejected", "clipped", "late")


def _times(levels: Entry) -> str:
    return f"median {number(levels['p50'])}, 99th percentile {number(levels['p99'])}"


def _rollouts(rollouts: Sequence[Entry]) -> Markup:
    head = ("Seed", "End", "Duration [s]", "RCM mean [mm]", "RCM max [mm]", "SPARC", "LDLJ")
    keys = ("duration_s", "rcm_mean_mm", "rcm_max_mm", "sparc", "ldlj", *_COUNTS)
    rows = [
        (
            e["seed"],
            SUCCESS if e["success"] else e["reason"],
            *(e[key] for key in keys),
            None if e["unsafe"] is None else e["unsafe"]["commands"],
        )
        for e in rollouts
    ]
    return section("Every roll-out", table((*head, *_COUNTS, "unsafe"), rows, right=range(2, 11)))


def _unsafe(summary: Entry) -> Markup:
    counted = summary["unsafe"]
    return section(
        f"Unsafe commands: {summary['unsafe_commands']} in {counted['cycles']} control cycles",
        note(
            "Counted from the recordings by code that shares nothing with the controller or the"
            " model server's safety controller."
        ),
        table(("Rule", "Cycles"), counted["rules"].items(), right=(1,)),
    )
