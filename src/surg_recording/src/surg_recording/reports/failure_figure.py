"""Why an episode did not succeed: a figure of its time, and a sentence on what happened last."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from surg_core.contract import SECOND_NS
from surg_core.transforms import rotate_back
from surg_recording.episode import episode_reader, table_file
from surg_recording.episode.episode_reader import Episode
from surg_recording.episode.table import Table
from surg_recording.recording_errors import EpisodeError
from surg_recording.reports import episode_events
from surg_recording.reports.episode_view_data import kept_rows
from surg_recording.reports.figure_style import (
    EXECUTED,
    FAINT,
    INPUT,
    LIMIT,
    TRUE,
    Drawn,
    blank,
    save_all,
)

CAPTION = (
    "Tip in the rcm frame, from where it was homed: the newest accepted command, the set-point, the"
    " measured tip; the jaw likewise. Red: a refused command. Above: the task's phases."
)
SHOWN = 4_000
"""Rows drawn of a table; more are thinned out and keep their extremes."""
NEAR = 0.04
"""Share of the time between two phases below which the second stays without its name."""
LEAST = 1.0
"""Shown at least of an axis to both sides of its beginning [mm]: noise looks like no motion."""

Array = npt.NDArray[np.float64]


def save(entry: Mapping[str, Any], run: Path, place: int) -> Drawn | None:
    """The figure of an entry of ``summary.json`` in a run's folder; None: nothing was recorded."""
    name, title = f"failure_{place:03d}", f"Episode {place}: {last_words(entry)}"
    try:
        recorded = episode_reader.read(run / entry["folder"] / "episode")
        figures = {name: (title, CAPTION, lambda: draw(recorded))}
        return next(iter(save_all(figures, run / "figures")), None)
    except (EpisodeError, KeyError, OSError):
        return None


def last_words(entry: Mapping[str, Any]) -> str:
    """What happened last, in one sentence."""
    lines = str(entry["failure_reason"] or "no reason is known").splitlines()
    why = " ".join(dict.fromkeys((lines[0], lines[-1]))).rstrip(".")
    during = f" in phase {entry['phase']!r}" if entry["phase"] else ""
    during = "" if during in why else during  # a time limit says it itself
    return f"{entry['outcome']} after {entry['duration_s']:.1f} s{during}: {why}."


def draw(recorded: Episode) -> Figure:
    """Tip and jaw of the first arm over the time of its recording."""
    arm = recorded.arms[0]
    cycle = table_file.read_table(recorded.folder / f"cycle_{arm}.csv", wanted=_WANTED)
    homed = cycle.select(cycle["homed"] == 1)
    cycle = homed if len(homed) else cycle
    start, pivot = int(cycle["stamp_ns"][0]), cycle.vector("p_rcm")
    q_BR = cycle.vector("q_br", "xyzw")
    tip, p_set, goal = (
        rotate_back(q_BR, cycle.vector(name) - pivot) for name in ("p_tip", "p_set", "p_goal")
    )
    rows = kept_rows([*tip.T, *p_set.T], SHOWN)
    t = _seconds(cycle["stamp_ns"], start)[rows]
    figure = blank(6.4)
    panels = figure.subplots(4, 1, sharex=True)
    lines = (
        ("command", goal, INPUT, 2.4),
        ("set-point", p_set, EXECUTED, 1.3),
        ("tip", tip, TRUE, 1),
    )
    for axis, axes in enumerate(panels[:3]):
        for name, values, colour, width in lines:
            moved = 1e3 * (values[rows, axis] - tip[0, axis])
            axes.plot(t, moved, color=colour, lw=width, label=name)
        axes.set_ylabel(f"{'xyz'[axis]} [mm]")
        low, high = axes.get_ylim()
        axes.set_ylim(min(low, -LEAST), max(high, LEAST))
    for name, colour in (("jaw_set", EXECUTED), ("jaw", TRUE)):
        panels[3].plot(t, np.degrees(cycle[name][rows]), color=colour)
    panels[3].set(ylabel="jaw [°]", xlabel=f"time from homing of {arm} [s]")
    _mark_refusals(panels, _refused(recorded, cycle, start))
    _name_phases(panels, recorded, start, float(t[-1]))
    panels[0].legend(loc="best", ncols=4, fontsize=8)
    return figure


_WANTED = (
    *("stamp_ns", "homed", "refused", "jaw_set", "jaw"),
    *(f"{name}_{axis}" for name in ("p_tip", "p_set", "p_goal", "p_rcm") for axis in "xyz"),
    *(f"q_br_{axis}" for axis in "xyzw"),
)


def _seconds(stamps: npt.NDArray[np.int64], start: int) -> Array:
    return np.asarray((stamps - start) / SECOND_NS)


def _refused(recorded: Episode, cycle: Table, start: int) -> Array:
    """Times [s] at which the arm refused a command, or the model server a step."""
    rows = np.flatnonzero(np.diff(cycle["refused"].astype(np.int64)) > 0) + 1
    found = [_seconds(cycle["stamp_ns"][rows], start)]
    for name in recorded.topics.get("/policy/rejected", ()):
        found.append(_seconds(recorded.table(name)["stamp_ns"], start))
    return np.concatenate(found)


def _mark_refusals(panels: npt.NDArray[Any], times: Array) -> None:
    for axes in panels:
        axes.margins(x=0.01)
        axes.plot(times, np.zeros(len(times)), "|", color=LIMIT, ms=11, mew=1.6,
                  transform=axes.get_xaxis_transform(), label=f"refused: {len(times)}")  # fmt: skip


def _name_phases(panels: npt.NDArray[Any], recorded: Episode, start: int, end: float) -> None:
    """Lines where the task's phase changes, and its name above."""
    named = -np.inf
    for stamp, name in episode_events.phases(recorded):
        t = (stamp - start) / SECOND_NS
        for axes in panels:
            axes.axvline(t, color=FAINT, lw=0.8, ls=":")
        if t - named > NEAR * end:
            at = panels[0].get_xaxis_transform()
            panels[0].text(t, 1.02, name, transform=at, fontsize=8, color=FAINT)
            named = t
