"""The step ``drift`` of ``./surg calibrate``: did a recorded episode show that something moved?"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from surg_core import ConfigError
from surg_core.config import Cell
from surg_perception.calibration.result_files import Origin, save_page
from surg_perception.depth.recorded_eyes import RecordedEyes, RecordedPair
from surg_perception.drift.accepted_drift import accept
from surg_perception.drift.drift_state import MOVED, UNKNOWN, DriftState
from surg_perception.drift.drift_verdict import NOTHING
from surg_perception.drift.drift_watch import DriftWatch
from surg_perception.drift.recorded_drift import show, watched
from surg_recording.episode import episode_reader
from surg_recording.reports.figure_style import encoded
from surg_recording.reports.html_page import document, facts, picture, section


def drift(
    cell: Cell,
    folder: Path,
    origin: Origin,
    write: bool,
    progress: Callable[[float], None] = lambda share: None,
) -> list[str]:
    """Watch an episode with the cell's calibration; lines for people, and a page.

    Args:
        cell: As it is calibrated now.
        folder: Of the episode.
        origin: Of what is written.
        write: Correct the calibration by what was seen.
        progress: Takes the share that is done.

    Raises:
        ConfigError: The cell is not calibrated, or nothing can be accepted.
        EpisodeError: The episode lacks pictures or joints.
    """
    begun: list[tuple[float, DriftState]] = []
    newest: tuple[DriftWatch, RecordedPair, DriftState] | None = None
    episode, since = episode_reader.read(folder), np.inf
    for newest in watched(cell, episode, progress):
        state = newest[2]
        if state.word != UNKNOWN:
            since = min(since, state.since) if state.word == MOVED else np.inf
        if not begun or (begun[-1][1].word, begun[-1][1].cause) != (state.word, state.cause):
            begun.append((state.since, state))
    if newest is None:
        raise ConfigError(f"{folder}: {UNKNOWN}: no instrument of the cell is seen while it moves")
    watch, pair, state = newest
    lines = [f"{at:.1f} s: {each.sentence()}" for at, each in begun]
    lines.append(f"at the end: {state.sentence()}")
    page = save_page(cell.folder / "calibration", "drift", _page(watch, pair, state, origin.note))
    lines.append(f"written: {page}: the shafts before and after the correction")
    if write:
        eyes = RecordedEyes(episode)

        def look(every: DriftWatch) -> None:
            for _ in show(cell, eyes, every, since, progress):
                pass

        paths = accept(cell, state, eyes.lenses, look, origin)
        lines += [f"written: {path}; the old one is {path.name}.previous" for path in paths]
    return lines


def _page(watch: DriftWatch, pair: RecordedPair, state: DriftState, title: str) -> str:
    """Both pictures with each shaft as joints and calibration put it, and as the verdict does."""
    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    for eye, (shown, name) in enumerate(((pair.left, "left"), (pair.right, "right"))):
        axes = figure.add_subplot(1, 2, eye + 1)
        axes.imshow(shown)
        axes.set_title(name)
        axes.set_axis_off()
        for before, after in watch.axes(eye):
            axes.plot(*before.T, color="yellow", label="before")
            axes.plot(*after.T, color="cyan", linestyle="--", label="after")
        axes.set_xlim(0, shown.shape[1])
        axes.set_ylim(shown.shape[0], 0)
    if figure.axes[0].get_legend_handles_labels()[0]:
        figure.axes[0].legend()
    caption = "Middle of each shaft: by joints and calibration, and by what was seen."
    verdict = watch.verdict
    rows = [] if verdict is None else sorted(verdict.probabilities.items(), key=lambda p: -p[1])
    named = [("nothing moved" if n == NOTHING else f"{n} moved", f"{p:.3f}") for n, p in rows]
    return document(
        title,
        [
            section("Drift", state.sentence(), picture(*encoded(figure), "shafts", caption)),
            section("Probabilities", facts(named)),
        ],
    )
