"""The report of many episodes: ``summary.json``, ``figures/*.png``, one self-contained page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from surg_recording.episode.finishing import clean_json, write_json
from surg_recording.reports import trial_figures
from surg_recording.reports.html_page import definitions, document, figure_section, number, text

_DEFINITIONS = (
    (
        "Success",
        "By the task's definition, from the simulator's ground truth (docs/reference/tasks.md). An"
        " episode that ends for any other reason is a failure; the table names the reason.",
    ),
    (
        "95 % interval",
        "Wilson's score interval of the success rate over all seeds.",
    ),
    (
        "RCM deviation, kinematic",
        "Distance from the commanded pivot to the shaft line, from joint states and calibration,"
        " at every control cycle from the first to the last stream command. It does not"
        " include calibration errors.",
    ),
    (
        "RCM deviation, true",
        "Distance from the unloaded trocar point, which moves with breathing, to the simulator's"
        " shaft axis.",
    ),
    (
        "Bound",
        "Reference value of the setting, for information. The parameters of the settings were fixed"
        " before any deviation was evaluated.",
    ),
)


def write(summary: Mapping[str, Any], folder: Path) -> None:
    """Write ``summary.json``, ``figures/`` and ``report.html``.

    Args:
        summary: Made by ``trials.summarise``; an episode may carry ``folder``, its own folder
            below this one.
        folder: The run's folder.

    Raises:
        OSError: The folder cannot be written.
    """
    result = clean_json(dict(summary))
    write_json(folder / "summary.json", result)
    drawn = trial_figures.save_all(summary, folder / "figures") if summary["episodes"] else []
    title = f"{summary['task']}: {summary['robot']}"
    sections = [
        f"<h1>{text(title)}</h1>",
        _verdict(summary),
        _conditions(summary["conditions"]),
        *map(figure_section, drawn),
        _episodes(summary["episodes"]),
        definitions(_DEFINITIONS),
    ]
    (folder / "report.html").write_text(document(title, sections), encoding="utf-8")


def interval(rate: Mapping[str, Any]) -> str:
    """A success rate with its interval, as people write it."""
    low, high = 100.0 * rate["low"], 100.0 * rate["high"]
    return f"{rate['k']} of {rate['n']} (95 % interval {low:.1f} to {high:.1f} %)"


def _verdict(summary: Mapping[str, Any]) -> str:
    kind = "ok" if summary["ok"] else "bad"
    reasons = "".join(f"<li>{text(reason)}</li>" for reason in summary["reasons"])
    words = f"<p>Not every episode was played to its end:</p><ul>{reasons}</ul>" if reasons else ""
    return (
        f"<section class='verdict {kind}'><h2>{text(interval(summary['success_rate']))} succeeded"
        f"</h2>{words}</section>"
    )


def _conditions(conditions: Sequence[Mapping[str, Any]]) -> str:
    rows = []
    for c in conditions:
        bounds = [
            f"{b['metric']} &lt; {b['value']:g}: "
            + (
                "<span class='met'>met</span>"
                if b["met"]
                else f"<span class='missed'>missed</span> ({number(b['worst'])})"
            )
            for b in c["bounds"]
        ]
        kinematic, true = c["rcm_kinematic_mm"], c["rcm_true_mm"]
        rows.append(
            f"<tr><td>{text(c['setting'])}</td><td>{text(c['law'])}</td>"
            f"<td>{text(interval(c['success_rate']))}</td>"
            f"<td class='n'>{_median_max(kinematic['mean'])}</td>"
            f"<td class='n'>{_median_max(kinematic['max'])}</td>"
            f"<td class='n'>{_median_max(true['max'])}</td>"
            f"<td class='n'>{_median_max(c['trocar_force_n'])}</td>"
            f"<td class='n'>{_median_max(c['trocar_displacement_mm'])}</td>"
            f"<td>{'<br>'.join(bounds)}</td></tr>"
        )
    return (
        "<section><h2>By condition</h2><p class='faint small'>Median and worst over the episodes;"
        " deviations and displacement in mm, force in N; first arm.</p><table><tr><th>Setting</th>"
        "<th>Law</th><th>Success</th><th>RCM mean</th><th>RCM max</th><th>true RCM max</th>"
        "<th>trocar force max</th><th>trocar displacement max</th><th>Bounds</th></tr>"
        f"{''.join(rows)}</table></section>"
    )


def _median_max(spread: Mapping[str, Any]) -> str:
    return f"{number(spread['median'])} / {number(spread['max'])}"


def _episodes(episodes: Sequence[Mapping[str, Any]]) -> str:
    rows = []
    for i, e in enumerate(episodes):
        end = "<span class='met'>success</span>" if e["success"] else text(e["failure_reason"])
        name = f"{i}"
        if e.get("folder"):
            name = f"<a href='{text(e['folder'])}/report.html'>{i}</a>"
        kinematic = e["rcm_kinematic_mm"] or {"mean": None, "max": None}
        true = e["rcm_true_mm"] or {"max": None}
        rows.append(
            f"<tr><td>{name}</td><td>{e['seed']}</td><td>{text(e['setting'])}</td>"
            f"<td>{text(e['law'])}</td><td>{end}</td><td class='n'>{number(e['duration_s'])}</td>"
            f"<td class='n'>{number(kinematic['mean'])}</td>"
            f"<td class='n'>{number(kinematic['max'])}</td><td class='n'>{number(true['max'])}</td>"
            f"<td><code>{text((e['state_hash'] or '–')[:12])}</code></td></tr>"
        )
    return (
        "<section><h2>Every episode</h2><table class='small'><tr><th></th><th>Seed</th>"
        "<th>Setting</th><th>Law</th><th>End</th><th>Duration [s]</th><th>RCM mean [mm]</th>"
        "<th>RCM max [mm]</th><th>true max [mm]</th><th>State hash</th></tr>"
        f"{''.join(rows)}</table></section>"
    )
