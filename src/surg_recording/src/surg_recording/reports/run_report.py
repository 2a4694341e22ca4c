"""The report of a run: ``summary.json``, ``figures/*.png`` and one self-contained ``report.html``.

On the command line: ``python -m surg_recording.reports.run_report RUN_DIR`` (exit code 0 when the
run met its
limits, 1 when not, 2 when there is no readable episode).
"""

from __future__ import annotations

import argparse
import io
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from surg_recording.clock import sync_page, sync_report
from surg_recording.episode import episode_reader as episodes
from surg_recording.episode.finishing import clean_json, write_json
from surg_recording.recording_errors import EpisodeError, NoMotionError
from surg_recording.reports import run_figures, run_series, run_summary
from surg_recording.reports.html_page import (
    definitions,
    document,
    embed,
    figure_section,
    number,
    text,
)
from surg_recording.video import video_file

STRIP_FRAMES = 6

_DEFINITIONS = (
    (
        "Window",
        "All values are measured from the first to the last control cycle that followed a servo"
        " command stream.",
    ),
    (
        "Kinematic RCM deviation",
        "Distance from the commanded pivot to the infinite shaft line, computed from joint states"
        " and calibration at every cycle. This is the paper's metric; it does not include"
        " calibration errors.",
    ),
    (
        "True RCM deviation",
        "Distance from the unloaded trocar point to the simulator's shaft axis.",
    ),
    (
        "Tip error",
        "Distance between the executed tip (the simulator's ground truth; without a simulator, the"
        " measured tip) and the input, shifted by the constant lag that minimises its rms. The lag"
        " is a value of its own.",
    ),
    (
        "Path length",
        "Length of the input and executed tip paths after a low-pass at 3 Hz (zero-phase"
        " Butterworth, order 4), which removes tremor.",
    ),
    (
        "Idle time",
        "Pauses of at least 0.5 s in which the executed tip, after the same low-pass, stays below"
        " 1 mm/s.",
    ),
    ("Shaft sweep", "The largest angle between any two shaft directions of the run."),
    (
        "Unscaled",
        "Cycles in which no limit slowed the motion (limit factor 1).",
    ),
    (
        "SPARC, LDLJ",
        "Spectral arc length and log dimensionless jerk of the tip motion at 5 Hz; closer to zero"
        " is smoother. Do not compare values of different presets.",
    ),
    (
        "Trocar displacement",
        "Distance of the trocar point under load from its unloaded position.",
    ),
    (
        "State hash",
        "SHA-256 over the simulator's positions and velocities after every tick. Two lock-step runs"
        " with the same seed have the same hash.",
    ),
)


def make(
    run_dir: Path | str, episode: Path | str | None = None, arm: str | None = None
) -> dict[str, Any]:
    """Measure, draw and write the report of a run.

    Args:
        run_dir: the run's folder; ``summary.json``, ``figures/`` and ``report.html`` go there.
        episode: the episode folder; default ``<run_dir>/episode``.
        arm: default: the first arm.

    Returns:
        What was written to ``summary.json``.

    Raises:
        EpisodeError: when there is no readable episode.
    """
    folder = Path(run_dir)
    recorded = episodes.read(Path(episode) if episode is not None else folder / "episode")
    try:
        run = run_series.load(recorded, arm)
    except NoMotionError:
        run = None
    result = clean_json(run_summary.summarise(recorded, arm, run))
    drawn: list[run_figures.Drawn] = []
    if run is not None:
        drawn = run_figures.save_all(run, result, _robot(recorded, run.arm), folder / "figures")
    strip, video_problem = _strip(recorded)
    write_json(folder / "summary.json", result)
    page = _page(recorded, result, drawn, strip, video_problem)
    (folder / "report.html").write_text(page, encoding="utf-8")
    return dict(result)


def _robot(recorded: episodes.Episode, arm: str) -> Mapping[str, Any]:
    arms = (recorded.manifest.get("cell") or {}).get("arms") or {}
    return (arms.get(arm) or {}).get("robot") or {}


# --- the page -----------------------------------------------------------------------------------


def _page(
    recorded: episodes.Episode,
    result: Mapping[str, Any],
    drawn: Sequence[run_figures.Drawn],
    strip: Sequence[tuple[str, bytes]],
    video_problem: str | None,
) -> str:
    what = result["motion"] or recorded.manifest.get("task") or "motion"
    title = f"{result['robot'] or 'robot'}: {what}"
    body = [
        f"<h1>{text(title)}</h1>",
        f"<p class='faint'>Recorded {text(recorded.manifest.get('created'))}"
        f" with software version {text(result['versions'].get('software') or 'unknown')}</p>",
        _verdict(result),
        _what_was_run(recorded, result),
    ]
    if result["limits"]:
        body.append(_limits(result))
        body.append(_numbers(result))
    if strip or video_problem:
        body.append(_frames(strip, video_problem))
    body += [figure_section(figure) for figure in drawn]
    body.append(sync_page.section(sync_report.ensure(recorded)))
    body += [_recording(recorded, result), definitions(_DEFINITIONS)]
    return document(title, body)


def _verdict(result: Mapping[str, Any]) -> str:
    if result["ok"]:
        return (
            "<section class='verdict ok'><h2>The run met every limit</h2>"
            "<p>The shaft stayed in the trocar while the tip followed its input.</p></section>"
        )
    reasons = "".join(f"<li>{text(reason)}</li>" for reason in result["reasons"])
    return (
        "<section class='verdict bad'><h2>The run did not meet its limits</h2>"
        f"<ul>{reasons}</ul></section>"
    )


def _what_was_run(recorded: episodes.Episode, result: Mapping[str, Any]) -> str:
    lockstep = result["time"] == "lockstep"
    deterministic = {True: "yes", False: "no", None: "not stated"}[result["deterministic"]]
    rows = [
        ("Robot and arm", f"{result['robot']}, {result['arm']}"),
        ("Cell", (recorded.manifest.get("cell") or {}).get("name")),
        ("Motion", result["motion"]),
        ("Task", None if result["motion"] else recorded.manifest.get("task")),
        ("Setting", (recorded.manifest.get("run") or {}).get("setting")),
        ("Duration", None if result["duration_s"] is None else f"{result['duration_s']:.2f} s"),
        ("Scale", result["scale"]),
        ("Mode", result["mode"]),
        ("Control law", result["law"]),
        ("Link", result["link"]),
        ("Seed", result["seed"]),
        ("Time", "lock-step (simulated time)" if lockstep else "free-run (real time)"),
        ("Repeatable", deterministic),
        ("State hash", result["state_hash"]),
        ("Operator", (recorded.manifest.get("run") or {}).get("operator")),
    ]
    cells = "".join(
        f"<tr><th>{text(name)}</th><td>{text(value)}</td></tr>"
        for name, value in rows
        if value is not None
    )
    return f"<section><h2>What was run</h2><table>{cells}</table></section>"


def _limits(result: Mapping[str, Any]) -> str:
    rows = []
    for limit in result["limits"]:
        mark = (
            "<span class='met'>met</span>"
            if limit["met"]
            else ("<span class='missed'>missed</span>" if limit["judged"] else "not reached")
        )
        if not limit["judged"]:
            mark += " <span class='faint small'>(for information)</span>"
        sign = "≥" if limit["sense"] == "at least" else "≤"
        rows.append(
            f"<tr><td>{text(limit['text'])}</td><td class='n'>{number(limit['measured'])}</td>"
            f"<td class='n'>{sign} {limit['bound']:g}</td><td>{mark}</td></tr>"
        )
    return (
        "<section><h2>Measured against the limits</h2><table><tr><th>Quantity</th><th>Measured</th>"
        f"<th>Limit</th><th></th></tr>{''.join(rows)}</table></section>"
    )


def _numbers(result: Mapping[str, Any]) -> str:
    controller, smooth = result["controller"], result["smoothness"]
    rows = [
        ("Kinematic RCM deviation", _spread(result["rcm_kinematic_mm"]), "mm"),
        ("True RCM deviation", _spread(result["rcm_true_mm"]), "mm"),
        ("Tip error", _pair(result["tip_error_mm"], "rms", "max"), "mm"),
        ("Tip error by joint states", _pair(result["tip_error_measured_mm"], "rms", "max"), "mm"),
        ("Tip lag", number(result["tip_lag_ms"]), "ms"),
        ("Path length", _pair(result["path_length_mm"], "input", "executed"), "mm"),
        ("Idle time", f"{number(result['idle']['s'])} s, pauses: {result['idle']['pauses']}", ""),
        ("Shaft sweep", number(result["shaft_sweep_deg"]), "°"),
    ]
    for name, values in smooth["presets"].items():
        for metric in ("sparc", "ldlj"):
            words = f"executed {number(values[metric])}, input {number(values['input'][metric])}"
            rows.append((f"{metric.upper()} (preset {name})", words, ""))
    if result["trocar"]:
        rows.append(("Trocar force", _pair(result["trocar"]["force_n"], "mean", "max"), "N"))
        moved = _pair(result["trocar"]["displacement_mm"], "mean", "max")
        rows.append(("Trocar displacement", moved, "mm"))
    rows.append(("Controller rate", number(controller["rate_hz"]), "Hz"))
    rows.append(("Compute time", _pair(controller["compute_us"], "p50", "p99"), "µs"))
    if controller["period_us"]:
        rows.append(("Period", _pair(controller["period_us"], "p50", "p99", "max"), "µs"))
    rows.append(("Overruns", number(controller["overruns"]), ""))
    rows.append(("Commands refused", number(result["commands_refused"]), ""))
    cells = "".join(
        f"<tr><td>{text(name)}</td><td>{text(value)} {unit}</td></tr>" for name, value, unit in rows
    )
    return f"<section><h2>All numbers</h2><table>{cells}</table></section>"


def _frames(strip: Sequence[tuple[str, bytes]], problem: str | None) -> str:
    shown = "".join(
        f"<figure><img alt='endoscope at {text(caption)}' src='{embed(data, 'jpeg')}'>"
        f"<figcaption>{text(caption)}</figcaption></figure>"
        for caption, data in strip
    )
    note = f"<p class='missed'>{text(problem)}</p>" if problem else ""
    return (
        f"<section><h2>Through the endoscope</h2>{note}<div class='strip'>{shown}</div></section>"
    )


def _recording(recorded: episodes.Episode, result: Mapping[str, Any]) -> str:
    rows = []
    entries = {**recorded.manifest["tables"], **recorded.manifest["videos"]}
    for name, entry in entries.items():
        count = entry.get("rows", entry.get("frames"))
        gap = None if entry.get("gap_max_s") is None else entry["gap_max_s"] * 1e3
        rows.append(
            f"<tr><td>{text(name)}</td><td class='n'>{count}</td>"
            f"<td class='n'>{number(entry.get('rate_hz'))}</td><td class='n'>{number(gap)}</td>"
            f"<td class='n'>{entry.get('dropped', 0)}</td></tr>"
        )
    versions = ", ".join(f"{k} {v}" for k, v in result["versions"].items() if v)
    outcome = recorded.manifest["outcome"]
    if recorded.manifest.get("reason"):
        outcome = f"{outcome}: {recorded.manifest['reason']}"
    cell = recorded.manifest.get("cell") or {}
    files = "".join(
        f"<tr><td><code>{text(name)}</code></td><td><code>{text(sha[:16])}…</code></td></tr>"
        for name, sha in (cell.get("files") or {}).items()
    )
    return (
        f"<section><h2>The recording</h2><p>{text(outcome)}</p><table><tr><th>Stream</th>"
        "<th>Rows or frames</th><th>Rate [Hz]</th><th>Largest gap [ms]</th><th>Dropped</th></tr>"
        f"{''.join(rows)}</table><p class='small faint'>Versions: {text(versions)}</p>"
        f"<details><summary class='small'>Configuration files and their SHA-256</summary>"
        f"<table class='small'>{files}</table></details></section>"
    )


# --- small things -------------------------------------------------------------------------------


def _strip(recorded: episodes.Episode) -> tuple[list[tuple[str, bytes]], str | None]:
    """Frames of the first camera, evenly over the run, as captions and JPEG files."""
    if not recorded.cameras:
        return [], None
    try:
        video = recorded.video(recorded.cameras[0])
        count = len(video.frames)
        if count == 0:
            return [], f"{video.name}: no frame was recorded"
        rows = np.unique(np.linspace(0, count - 1, STRIP_FRAMES).astype(int))
        images = video_file.grab(video.path, [int(row) for row in rows])
    except EpisodeError as problem:
        return [], str(problem)
    stamps = video.frames["stamp_ns"]
    strip = []
    for row, image in zip(rows, images, strict=False):  # a cut video may hold fewer
        buffer = io.BytesIO()
        Image.fromarray(image).save(buffer, "JPEG", quality=85)
        seconds = (int(stamps[row]) - int(stamps[0])) * 1e-9
        strip.append((f"{seconds:.1f} s", buffer.getvalue()))
    return strip, None


def _pair(values: Mapping[str, Any] | None, *keys: str) -> str:
    if values is None:
        return "–"
    return ", ".join(f"{key} {number(values[key])}" for key in keys)


def _spread(values: Mapping[str, Any] | None) -> str:
    return _pair(values, "mean", "median", "p95", "max")


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m surg_recording.reports.run_report",
        description="Write summary.json, figures/ and report.html of a recorded run.",
    )
    parser.add_argument("run_dir", type=Path, help="the run's folder")
    parser.add_argument("--episode", type=Path, help="episode folder (default: RUN_DIR/episode)")
    parser.add_argument("--arm", help="arm to report on (default: the first)")
    given = parser.parse_args(arguments)
    try:
        result = make(given.run_dir, given.episode, given.arm)
    except (EpisodeError, OSError) as problem:
        print(f"report: {problem}", file=sys.stderr)
        return 2
    for reason in result["reasons"]:
        print(reason, file=sys.stderr)
    print(given.run_dir / "summary.json")
    return 0 if result["ok"] else 1


if __name__ == "__main__":
    sys.exit(main())
