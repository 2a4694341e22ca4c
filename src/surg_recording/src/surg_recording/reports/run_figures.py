"""The figures of a run."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from surg_recording import metrics
from surg_recording.reports.figure_style import (
    EXECUTED,
    FOOTNOTE,
    INK,
    INPUT,
    LIMIT,
    TRUE,
    Drawn,
    Figures,
    blank,
    save_all,
)
from surg_recording.reports.run_series import Run
from surg_recording.reports.tip_path_figure import tip_path

Array = npt.NDArray[np.float64]
Values = Mapping[str, Any]

JOINTS = ("#1d6fb8", "#d9762b", "#2f8f5b", "#8a5cb8", "#c62f3b", "#4a5568", "#b8a11d")


def rcm_deviation(run: Run, summary: Values, robot: Values) -> Figure:
    """Distance between pivot and shaft over time, with its distribution."""
    figure = blank(3.4)
    over_time, spread = figure.subplots(1, 2, width_ratios=[4.2, 1], sharey=True)
    series = [("kinematic", run.t, run.rcm_kinematic, EXECUTED)]
    if run.truth is not None:
        series.insert(0, ("true", run.t_truth, run.rcm_true, TRUE))
    floor = 1e-4
    top = max(float(np.nanmax(d)) for _, _, d, _ in series) * 1e3
    for name, t, deviation, colour in series:
        mm = np.maximum(deviation * 1e3, floor)
        broad = name == "true"
        middle, low_mm, high_mm, centre = envelope(t, mm)
        over_time.fill_between(middle, low_mm, high_mm, color=colour, alpha=0.3, linewidth=0)
        over_time.plot(middle, centre, color=colour, linewidth=1.2)
        levels = metrics.percentiles(mm, *np.linspace(0, 100, 201))
        mean = float(np.mean(mm))
        spread.plot(np.linspace(0, 100, 201), levels, color=colour, linewidth=3.2 if broad else 1.4)
        over_time.plot([], [], color=colour, linewidth=2.5, label=f"{name}: mean {mean:.3f} mm")
    bounds = {limit["name"]: limit["bound"] for limit in summary["limits"]}
    for name, style in (("kinematic", "--"), ("true", ":")):
        if bound := bounds.get(f"rcm_{name}_max"):
            for axes in (over_time, spread):
                axes.axhline(bound, color=LIMIT, linewidth=1.0, linestyle=style)
            font = {"color": LIMIT, "fontsize": 8, "ha": "right", "va": "bottom"}
            over_time.text(run.t[-1] * 0.995, bound * 1.06, f"{name} max allowed", font)
    over_time.set_yscale("log")
    low = float(np.percentile(np.concatenate([d for _, _, d, _ in series]), 1)) * 1e3
    over_time.set_ylim(max(floor, low / 2), max(1.2, top * 2.5))
    over_time.yaxis.set_major_formatter(matplotlib.ticker.FuncFormatter(lambda y, _: f"{y:g}"))
    over_time.set(title="Distance between pivot and shaft", xlabel="time [s]")
    over_time.set_ylabel("RCM deviation [mm]")
    over_time.legend(loc="upper left", ncols=2)
    over_time.set_xlim(0, run.t[-1])
    spread.set(title="Distribution", xlabel="% of samples below")
    spread.set_xlim(0, 100)
    return figure


BANDS = 240
"""Intervals over which an envelope is drawn."""


def envelope(t: Array, values: Array) -> tuple[Array, Array, Array, Array]:
    """Middle time, minimum, maximum and median of values in equal intervals, each (n,), n <= 240.

    The extremes of all samples are kept; an interval without a sample is left out.
    """
    edges = np.linspace(t[0], t[-1], min(BANDS, len(t)) + 1)
    place = np.clip(np.searchsorted(edges, t, side="right") - 1, 0, len(edges) - 2)
    firsts = np.flatnonzero(np.diff(place, prepend=-1))
    pieces = np.split(values, firsts[1:])
    levels = [(np.nanmin(piece), np.nanmax(piece), np.nanmedian(piece)) for piece in pieces]
    low, high, centre = np.array(levels).T
    return (edges[place[firsts]] + edges[place[firsts] + 1]) / 2, low, high, centre


def tip_error(run: Run, summary: Values, robot: Values) -> Figure:
    """Distance between executed tip and input over time, lag removed."""
    figure = blank(3.0)
    axes = figure.subplots()
    tracking = run.tracking
    assert tracking is not None
    mm = tracking.error * 1e3
    axes.plot(run.t_executed, mm, color=EXECUTED, linewidth=0.8)
    axes.axhline(tracking.rms * 1e3, color=INK, linewidth=1.0)
    bounds = {limit["name"]: limit["bound"] for limit in summary["limits"]}
    bound = bounds.get("tip_error_rms", np.inf)
    top = max(1.15 * float(np.nanmax(mm)), 1e-3)
    if bound < 4 * top:
        top = max(top, 1.1 * bound)
        axes.axhline(bound, color=LIMIT, linestyle="--", linewidth=1.0)
        axes.text(0, bound, " rms allowed", color=LIMIT, fontsize=8, va="bottom")
    axes.set_ylim(0, top)
    axes.set_xlim(0, run.t[-1])
    lag = tracking.lag * 1e3
    rms, most = tracking.rms * 1e3, tracking.max * 1e3
    title = f"Tip error:  rms {rms:.3f} mm (line),  max {most:.3f} mm,  after {lag:.1f} ms lag"
    axes.set(title=title, xlabel="time [s]", ylabel="tip error [mm]")
    return figure


def speed(run: Run, summary: Values, robot: Values) -> Figure:
    """Tip speed of input and executed motion, at loop rate and at the metrics' rate."""
    figure = blank(3.6)
    axes = figure.subplots()
    fs = run.fs
    smoothness = summary["smoothness"]
    preset = metrics.PRESETS[smoothness["preset"]]
    executed = metrics.uniform(run.t_executed, run.executed, fs)
    given = metrics.uniform(run.t, metrics.interpolate(run.t, run.t_input, run.input), fs)
    mm_per_s = np.linalg.norm(metrics.differentiate(executed[1], fs), axis=1) * 1e3
    axes.plot(executed[0], mm_per_s, color="#bcd3e8", linewidth=0.6, label=f"executed, {fs:g} Hz")
    for name, (grid, path), colour, width in (
        ("input", given, INPUT, 2.4),
        ("executed", executed, EXECUTED, 1.2),
    ):
        slow = metrics.downsample(metrics.differentiate(path, fs), fs, preset.fs)
        t, mm_per_s = grid[0] + np.arange(len(slow)) / preset.fs, np.linalg.norm(slow, axis=1) * 1e3
        axes.plot(t, mm_per_s, color=colour, linewidth=width, label=f"{name}, {preset.fs:g} Hz")
    first = smoothness["presets"][smoothness["preset"]]
    axes.set_title(
        f"Tip speed    SPARC {_value(first['sparc'])} (input {_value(first['input']['sparc'])}),"
        f"  LDLJ {_value(first['ldlj'])} (input {_value(first['input']['ldlj'])})"
    )
    footnote = "\n".join(textwrap.wrap(preset.label(), FOOTNOTE))
    axes.set(xlabel=f"time [s]\n{footnote}", ylabel="tip speed [mm/s]")
    axes.set_xlim(0, run.t[-1])
    axes.set_ylim(bottom=0)
    axes.margins(y=0.12)
    axes.legend(loc="upper right", ncols=3)
    return figure


def joints(run: Run, summary: Values, robot: Values) -> Figure:
    """Joint positions and velocities beside their limits."""
    figure = blank(5.2)
    position, velocity = figure.subplots(2, 1, sharex=True)
    stated = robot.get("joints") or {}
    q, qd = run.cycle.joints("q"), run.cycle.joints("qd")
    names = stated.get("names") or [f"q{i}" for i in range(q.shape[1])]
    low, high = _numbers(stated, "position_min", q), _numbers(stated, "position_max", q)
    fastest = _numbers(stated, "velocity", q)
    position.set(title="Joint positions", ylabel="position [rad]")
    velocity.set(title="Joint velocities", ylabel="velocity [rad/s]", xlabel="time [s]")
    if low is not None and high is not None:
        q = 200.0 * (q - low) / (high - low) - 100.0
        position.set(title="Joint positions within their range", ylabel="position [% of range]")
        position.set_ylim(-112, 112)
        _bounds_at_100(position)
    if fastest is not None:
        qd = 100.0 * qd / fastest
        fast = float(np.max(np.abs(qd)))
        title = f"Joint velocities: at most {fast:.0f} % of their limits"
        velocity.set(title=title, ylabel="velocity [% of limit]")
        if fast > 50.0:
            _bounds_at_100(velocity)
    for i, name in enumerate(names[: q.shape[1]]):
        colour = JOINTS[i % len(JOINTS)]
        position.plot(run.t, q[:, i], color=colour, label=str(name))
        velocity.plot(run.t, qd[:, i], color=colour, linewidth=0.8)
    velocity.set_xlim(0, run.t[-1])
    position.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), handlelength=1.2)
    return figure


def _bounds_at_100(axes: Axes) -> None:
    for bound in (-100, 100):
        axes.axhline(bound, color=LIMIT, linestyle="--", linewidth=1.0)


FIGURES: Figures = {
    "rcm_deviation": (
        "Does the shaft stay in the trocar?",
        "Kinematic: from the commanded pivot to the shaft line computed from the joints. True: from"
        " the trocar's unloaded point to the simulator's shaft axis. Line: median, band: smallest"
        " and largest value, in 240 intervals. Logarithmic scale.",
        rcm_deviation,
    ),
    "tip_path": (
        "Where does the tip go?",
        "Tip path in the rcm frame: the trocar is the origin, depth points into the patient along"
        " the shaft's home axis. Thin grey lines: the shaft at regular times.",
        lambda run, *_: tip_path(run),
    ),
    "tip_error": (
        "How closely does the tip follow its input?",
        "Distance between the executed tip and the input, shifted by the constant lag that"
        " minimises the rms distance.",
        tip_error,
    ),
    "speed": (
        "How smooth is the motion?",
        "Tip speed at loop rate, and downsampled as for the smoothness metrics.",
        speed,
    ),
    "joints": (
        "What do the joints do?",
        "Measured joint positions and velocities relative to the robot's limits.",
        joints,
    ),
}


def save_figures(run: Run, summary: Values, robot: Values, folder: Path) -> list[Drawn]:
    """Draw every figure that the run has data for; ``robot`` is its YAML, empty if unknown."""
    figures = dict(FIGURES)
    if run.tracking is None:
        del figures["tip_error"]
    return save_all(figures, folder, run, summary, robot)


def _numbers(stated: Mapping[str, Any], key: str, q: Array) -> Array | None:
    values = stated.get(key)
    if not isinstance(values, list) or len(values) != q.shape[1]:
        return None
    return np.array(values, dtype=float)


def _value(value: float | None) -> str:
    return "–" if value is None or not np.isfinite(value) else f"{value:.2f}"
