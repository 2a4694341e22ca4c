"""The report of a run: ``summary.json``, ``figures/*.png``, self-contained ``report.html``."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from PIL import Image

from surg_recording.clock import sync_page, sync_report
from surg_recording.episode import episode_reader as episodes
from surg_recording.episode.finishing import clean_json, write_json
from surg_recording.recording_errors import EpisodeError, NoMotionError
from surg_recording.reports import run_figures, run_series, run_summary
from surg_recording.reports.figure_style import Drawn
from surg_recording.reports.html_page import (
    MET,
    MISSED,
    bullets,
    code,
    definitions,
    document,
    facts,
    figure_section,
    film_section,
    folded,
    grid,
    marked,
    note,
    number,
    picture,
    section,
    table,
)
from surg_recording.reports.terms import named
from surg_recording.video import video_file

FOR_INFORMATION = marked("faint small", "(for information)")
STRIP_FRAMES = 6

_TERMS = (
    *("Window", "Kinematic RCM deviation", "True RCM deviation", "Tip error", "Path length"),
    *("Idle time", "Shaft sweep", "Unscaled", "SPARC, LDLJ", "Trocar displacement", "State hash"),
)


def make(
    run_dir: Path | str, episode: Path | str | None = None, arm: str | None = None
) -> dict[str, Any]:
    """Measure a run, draw its figures and write its report; returns ``summary.json``.

    The episode is ``<run_dir>/episode`` by default, the arm the first; an EpisodeError if there is
    no readable episode.
    """
    folder = Path(run_dir)
    recorded = episodes.read(Path(episode) if episode is not None else folder / "episode")
    try:
        run = run_series.load(recorded, arm)
    except NoMotionError:
        run = None
    result = clean_json(run_summary.summarise(recorded, arm, run))
    drawn: list[Drawn] = []
    if run is not None:
        arms = (recorded.manifest.get("cell") or {}).get("arms") or {}
        robot = (arms.get(run.arm) or {}).get("robot") or {}
        drawn = run_figures.save_figures(run, result, robot, folder / "figures")
    write_json(folder / "summary.json", result)
    (folder / "report.html").write_text(_page(recorded, result, drawn, folder), encoding="utf-8")
    return dict(result)


def _page(
    recorded: episodes.Episode, result: Mapping[str, Any], drawn: Sequence[Drawn], folder: Path
) -> str:
    run = recorded.manifest.get("run") or {}
    subject = run.get("title") or result["motion"] or recorded.manifest.get("task") or "motion"
    title = f"{named(subject)}: {named(result['robot'] or 'robot')}"
    measured = [_limits(result), _numbers(result)] if result["limits"] else []
    film = film_section(
        folder, "Endoscope as recorded, and the room drawn from the recorded joint positions."
    )
    sections = [
        film or _frames(recorded),
        _verdict(result),
        *measured[:1],
        *map(figure_section, drawn),
        _what_was_run(recorded, result),
        *measured[1:],
        sync_page.section(sync_report.ensure(recorded)),
        _recording(recorded, result),
        definitions(*_TERMS),
    ]
    created = number(recorded.manifest.get("created"))
    version = result["versions"].get("software") or "unknown"
    return document(title, sections, f"Recorded {created} with software version {version}")


def _verdict(result: Mapping[str, Any]) -> Markup:
    if result["ok"]:
        words = "The shaft stayed in the trocar while the tip followed its input."
        return section("The run met every limit", words, verdict="ok")
    return section("The run did not meet its limits", bullets(result["reasons"]), verdict="bad")


def _what_was_run(recorded: episodes.Episode, result: Mapping[str, Any]) -> Markup:
    manifest = recorded.manifest
    run = manifest.get("run") or {}
    lockstep = result["time"] == "lockstep"
    rows = [
        ("Robot and arm", f"{result['robot']}, {result['arm']}"),
        ("Cell", (manifest.get("cell") or {}).get("name")),
        ("Motion", result["motion"]),
        ("Task", None if result["motion"] else manifest.get("task")),
        ("Setting", run.get("setting")),
        ("Duration", None if result["duration_s"] is None else f"{result['duration_s']:.2f} s"),
        ("Scale", result["scale"]),
        ("Mode", result["mode"]),
        ("Control law", result["law"]),
        ("Link", result["link"]),
        ("Seed", result["seed"]),
        ("Time", "lock-step (simulated time)" if lockstep else "free-run (real time)"),
        ("Repeatable", {True: "yes", False: "no", None: "not stated"}[result["deterministic"]]),
        ("State hash", result["state_hash"]),
        ("Operator", run.get("operator")),
    ]
    return section("What was run", facts(row for row in rows if row[1] is not None))


def _limits(result: Mapping[str, Any]) -> Markup:
    rows = []
    for limit in result["limits"]:
        judged = limit["judged"]
        outcome = MET if limit["met"] else MISSED if judged else "not reached"
        mark = outcome if judged else Markup("{} {}").format(outcome, FOR_INFORMATION)
        sign = "≥" if limit["sense"] == "at least" else "≤"
        rows.append((limit["text"], limit["measured"], f"{sign} {limit['bound']:g}", mark))
    head = ("Quantity", "Measured", "Limit", "")
    return section("Measured against the limits", table(head, rows, right=(1, 2)))


def _numbers(result: Mapping[str, Any]) -> Markup:
    controller, trocar = result["controller"], result["trocar"] or {}
    spread = ("mean", "median", "p95", "max")
    smoothness = [
        (
            f"{metric.upper()} (preset {name})",
            f"executed {number(values[metric])}, input {number(values['input'][metric])}",
        )
        for name, values in result["smoothness"]["presets"].items()
        for metric in ("sparc", "ldlj")
    ]
    rows = [
        ("Kinematic RCM deviation", _levels(result["rcm_kinematic_mm"], "mm", *spread)),
        ("True RCM deviation", _levels(result["rcm_true_mm"], "mm", *spread)),
        ("Tip error", _levels(result["tip_error_mm"], "mm", "rms", "max")),
        ("Tip error by joint states", _levels(result["tip_error_measured_mm"], "mm", "rms", "max")),
        ("Tip lag", f"{number(result['tip_lag_ms'])} ms"),
        ("Path length", _levels(result["path_length_mm"], "mm", "input", "executed")),
        ("Idle time", f"{number(result['idle']['s'])} s, pauses: {result['idle']['pauses']}"),
        ("Shaft sweep", f"{number(result['shaft_sweep_deg'])} °"),
        *smoothness,
        ("Trocar force", _levels(trocar.get("force_n"), "N", "mean", "max")),
        ("Trocar displacement", _levels(trocar.get("displacement_mm"), "mm", "mean", "max")),
        ("Controller rate", f"{number(controller['rate_hz'])} Hz"),
        ("Compute time", _levels(controller["compute_us"], "µs", "p50", "p99")),
        ("Period", _levels(controller["period_us"], "µs", "p50", "p99", "max")),
        ("Overruns", controller["overruns"]),
        ("Commands refused", result["commands_refused"]),
    ]
    return section("All numbers", facts(rows))


def _levels(values: Mapping[str, Any] | None, unit: str, *keys: str) -> str:
    if values is None:
        return "–"
    return ", ".join(f"{key} {number(values[key])}" for key in keys) + f" {unit}"


def _frames(recorded: episodes.Episode) -> Markup:
    """Frames of the first camera, evenly over the run; nothing without a camera."""
    if not recorded.cameras:
        return Markup()
    try:
        video = recorded.video(recorded.cameras[0])
        if not len(video.frames):
            raise EpisodeError(f"{video.name}: no frame was recorded")
        rows = np.unique(np.linspace(0, len(video.frames) - 1, STRIP_FRAMES).astype(int))
        images = video_file.grab(video.path, rows.tolist())
    except EpisodeError as problem:
        return section("Through the endoscope", marked("missed", problem))
    seconds = (video.frames["stamp_ns"] - video.frames["stamp_ns"][0]) * 1e-9
    pictures = []
    for row, image in zip(rows, images, strict=False):  # a truncated video may hold fewer
        buffer = io.BytesIO()
        Image.fromarray(image).save(buffer, "JPEG", quality=85)
        caption = f"{seconds[row]:.1f} s"
        data = buffer.getvalue()
        pictures.append(picture(data, "jpeg", f"endoscope at {caption}", caption))
    return section("Through the endoscope", grid(pictures, "three"))


def _recording(recorded: episodes.Episode, result: Mapping[str, Any]) -> Markup:
    manifest = recorded.manifest
    rows = [
        (
            name,
            entry.get("rows", entry.get("frames")),
            entry.get("rate_hz"),
            None if entry.get("gap_max_s") is None else entry["gap_max_s"] * 1e3,
            entry.get("dropped", 0),
        )
        for name, entry in {**manifest["tables"], **manifest["videos"]}.items()
    ]
    outcome = ": ".join(filter(None, (manifest["outcome"], manifest.get("reason"))))
    versions = ", ".join(f"{k} {v}" for k, v in result["versions"].items() if v)
    files = ((manifest.get("cell") or {}).get("files") or {}).items()
    hashes = [(code(name), f"{sha[:16]}…") for name, sha in files]
    head = ("Stream", "Rows or frames", "Rate [Hz]", "Largest gap [ms]", "Dropped")
    return section(
        "The recording",
        outcome,
        table(head, rows, right=range(1, 5)),
        note(f"Versions: {versions}"),
        folded("Configuration files", table(("File", "SHA-256"), hashes)),
    )
