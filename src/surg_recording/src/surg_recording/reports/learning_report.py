"""The report of a policy that was learned: ``summary.json``, ``figures/*.png``, one page."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from surg_recording.episode.finishing import clean_json, write_json
from surg_recording.reports import trial_figures
from surg_recording.reports.html_page import document, figure_section, number, text
from surg_recording.reports.run_figures import save
from surg_recording.reports.trial_report import interval

Entry = Mapping[str, Any]

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
    """Write all of it.

    Args:
        summary: Made by ``learning.summarise``.
        played: Entries of the roll-outs, made by ``trials.describe``.
        shown: Entries of demonstrations.
        folder: Where it goes.

    Raises:
        OSError: The folder cannot be written.
    """
    write_json(folder / "summary.json", clean_json(dict(summary)))
    groups = [
        (f"demonstrations\nn = {len(shown)}", shown),
        (f"roll-outs\nn = {len(played)}", played),
    ]
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    no_bounds: Mapping[str, Any] = {"conditions": []}
    drawn = [
        save(
            folder / "figures",
            name,
            title,
            caption,
            functools.partial(draw, groups, no_bounds),
        )
        for name, (title, caption, draw) in _FIGURES.items()
    ]
    title = f"{summary['title']}: a learned policy"
    sections = [
        f"<h1>{text(title)}</h1>",
        _verdict(summary),
        _what(summary),
        *map(figure_section, drawn),
        _rollouts(summary["rollouts"]),
        _unsafe(summary),
    ]
    (folder / "report.html").write_text(document(title, sections), encoding="utf-8")


def _verdict(summary: Entry) -> str:
    kind = "ok" if summary["ok"] else "bad"
    reasons = "".join(f"<li>{text(reason)}</li>" for reason in summary["reasons"])
    return (
        f"<section class='verdict {kind}'><h2>{text(interval(summary['success_rate']))} succeeded"
        f"</h2><ul>{reasons}</ul></section>"
    )


def _what(summary: Entry) -> str:
    """What it was made of, what it looks at, how long each stage took."""
    looks = ", ".join(summary["observation"])
    privileged = ", ".join(summary["privileged"])
    rows = [
        ("Task, setting, robot", f"{summary['task']}, {summary['setting']}, {summary['robot']}"),
        (
            "Demonstrations",
            f"{summary['demonstrations']}, {summary['demonstrations_success']} solved",
        ),
        ("Observation", looks),
        ("Ground truth that no robot can measure", privileged or "none"),
        ("Policy", summary["policy"]),
        ("RCM deviation of the roll-outs, largest [mm]", number(summary["rcm_max_mm"]["max"])),
        ("Rejected, clipped, late actions", ", ".join(number(summary[n]) for n in _COUNTS)),
        ("Age of the observation at execution [ms]", _ages(summary["obs_age_ms"])),
        ("Round trip [ms]", _ages(summary["round_trip_ms"])),
        *((f"Stage {name} [s]", f"{s:.0f}") for name, s in summary["stages_s"].items()),
    ]
    cells = "".join(f"<tr><th>{text(a)}</th><td>{text(b)}</td></tr>" for a, b in rows)
    return f"<section><h2>What was done</h2><table>{cells}</table></section>"


_COUNTS = ("rejected", "clipped", "late")


def _ages(found: Entry) -> str:
    return f"median {number(found['p50'])}, 99th percentile {number(found['p99'])}"


def _rollouts(rollouts: Sequence[Entry]) -> str:
    rows = []
    for e in rollouts:
        end = "<span class='met'>success</span>" if e["success"] else text(e["reason"])
        unsafe = None if e["unsafe"] is None else e["unsafe"]["commands"]
        numbers = (e["duration_s"], e["rcm_mean_mm"], e["rcm_max_mm"], e["sparc"], e["ldlj"])
        rows.append(
            f"<tr><td>{e['seed']}</td><td>{end}</td>"
            + "".join(f"<td class='n'>{number(n)}</td>" for n in numbers)
            + "".join(f"<td class='n'>{number(e[n])}</td>" for n in _COUNTS)
            + f"<td class='n'>{number(unsafe)}</td></tr>"
        )
    head = (
        *("Seed", "End", "Duration [s]", "RCM mean [mm]", "RCM max [mm]", "SPARC", "LDLJ"),
        *("rejected", "clipped", "late", "unsafe"),
    )
    return (
        "<section><h2>Every roll-out</h2><table class='small'><tr>"
        + "".join(f"<th>{text(name)}</th>" for name in head)
        + f"</tr>{''.join(rows)}</table></section>"
    )


def _unsafe(summary: Entry) -> str:
    looked = summary["unsafe"]
    rows = "".join(
        f"<tr><td>{text(name)}</td><td class='n'>{cycles}</td></tr>"
        for name, cycles in looked["rules"].items()
    )
    return (
        f"<section><h2>Unsafe commands: {summary['unsafe_commands']} in {looked['cycles']} control"
        " cycles</h2><p class='faint small'>Counted from the recordings by code that shares nothing"
        " with the controller or the model server's safety controller.</p><table><tr><th>Rule</th>"
        f"<th>Cycles</th></tr>{rows}</table></section>"
    )
