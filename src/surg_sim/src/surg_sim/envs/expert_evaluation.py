r"""Figures of the scripted senders and of the controller over many episodes, in process.

Two tables: every task in every setting over test seeds, and an ablation of the settings'
disturbances: all together by three laws, and those of the strongest setting each alone. ::

    python3 -m surg_sim.envs.expert_evaluation --episodes 100 --out docs/results/phantom.md
    python3 -m surg_sim.envs.expert_evaluation --episodes 20 --ablation 0 \
        --tasks pick_and_place --update docs/results/phantom.md

The second command puts the rows of one task into the page that the first one wrote.
These are figures of a simulation.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

from surg_core.wilson import wilson_interval
from surg_sim import tasks
from surg_sim.envs import rows_of_page
from surg_sim.envs.cell_session import CellSession
from surg_sim.envs.episode_runner import EpisodeReport, run_episode
from surg_sim.physics import cell_files
from surg_sim.physics.patient_settings import SETTINGS, Breathing, PatientSetting, find_setting
from surg_sim.physics.trocar import TrocarParameters
from surg_sim.tasks import episode_seeds

ROBOTS = {"UR5e": "sim_two_arms", "Panda": "sim_two_arms_panda"}
"""Robot of the instrument, and the bundled cell with it."""
STRONGEST = "in_vivo"
"""The setting of which each disturbance is played alone."""
GONE = TrocarParameters(stiffness=0.1, friction=0.0)
"""A wall that is not felt."""


@dataclass(frozen=True)
class Series:
    """Episodes of one task under one condition."""

    label: str  # what a reader sees
    cell: str  # name or path
    task: str  # name
    condition: PatientSetting  # physical parameters
    law: str  # of ``session.LAWS``
    seeds: tuple[int, ...]  # of the episodes

    def run(self) -> list[EpisodeReport]:
        """All episodes, one after another, in one compiled scene."""
        path = cell_files.find(self.cell)
        session = CellSession(path, self.task, self.condition, self.seeds[0], law=self.law)
        return [run_episode(session, seed) for seed in self.seeds]


def alone(setting: PatientSetting) -> dict[str, PatientSetting]:
    """The disturbances of a setting, each alone, then all together; drives are the robot's own.

    Nothing disturbs the first one: no wall, no breathing, an exact calibration and encoder. What
    acts through the wall (friction, breathing) needs one.
    """
    none = replace(
        setting, name="none", trocar=GONE, breathing=Breathing(), tool_error=None, encoder=0.0
    )
    wall = replace(setting.trocar, friction=0.0)
    disturbances = {
        "nothing but the drives": none,
        "wall": replace(none, trocar=wall),
        "seal friction with the wall": replace(none, trocar=setting.trocar),
        "breathing with the wall": replace(none, trocar=wall, breathing=setting.breathing),
        "calibration error": replace(none, tool_error=setting.tool_error),
        "encoder": replace(none, encoder=setting.encoder),
        "all together": setting,
    }
    return {name: replace(value, name=name) for name, value in disturbances.items()}


def _cells(series: Series, reports: Sequence[EpisodeReport]) -> tuple[str, ...]:
    """Success, interval; largest kinematic and true deviation, and force."""
    arm = tasks.load(series.task).commanded[0]
    good = sum(report.success for report in reports)
    low, high = wilson_interval(good, len(reports))
    parts = [report.arms[arm] for report in reports]

    def largest(name: str, scale: float) -> str:
        return f"{scale * max(getattr(part, name).max for part in parts):.3f}"

    return (
        f"{good}/{len(reports)}",
        f"{100 * low:.0f}–{100 * high:.0f}",
        largest("kinematic", 1e3),
        largest("true", 1e3),
        largest("force", 1.0),
    )


def _side_by_side(cells: Sequence[str]) -> str:
    """Of each setting; once where they are the same."""
    return cells[0] if len(set(cells)) == 1 else ", ".join(cells)


def first_rows(done: Sequence[tuple[Series, Sequence[EpisodeReport]]]) -> dict[str, str]:
    """Rows of the first table by task and robot: each cell has the settings side by side."""
    by_label: dict[str, list[tuple[str, ...]]] = {}
    for series, reports in done:
        label = series.label.rpartition(", ")[0]
        by_label.setdefault(label, []).append(_cells(series, reports))
    return {
        label: f"| {label} | {' | '.join(map(_side_by_side, zip(*cells, strict=True)))} |"
        for label, cells in by_label.items()
    }


_HEAD = (
    "| {} | success | 95 % [%] | kinematic [mm] | true [mm] | force [N] |\n"
    "|---|---|---|---|---|---|"
)


def failures(rows: Iterable[tuple[str, Sequence[EpisodeReport]]]) -> list[str]:
    """Every kind of failure with its count and seeds."""
    lines: list[str] = []
    for label, reports in rows:
        kinds = [report.reason.partition(":")[0] for report in reports]
        causes = Counter(kind for kind in kinds if kind)
        for cause, n in sorted(causes.items()):
            bad = [
                str(report.seed)
                for report, kind in zip(reports, kinds, strict=True)
                if kind == cause
            ]
            lines.append(f"- {label}: {n} × {cause} (seeds {', '.join(bad)})")
    return lines or ["None."]


def _timed(series: Series) -> tuple[list[EpisodeReport], float]:
    """Its episodes, and simulated over real time with the compilation of the scene."""
    began = time.perf_counter()
    reports = series.run()
    return reports, sum(report.duration for report in reports) / (time.perf_counter() - began)


def run_all(series: Sequence[Series], jobs: int) -> list[list[EpisodeReport]]:
    """Run series, several at a time; says how far it is, and how fast, on stderr."""
    with ProcessPoolExecutor(max_workers=jobs) as pool:
        waiting = [pool.submit(_timed, each) for each in series]
        results = []
        for each, future in zip(series, waiting, strict=True):
            reports, speed = future.result()
            results.append(reports)
            line = f"{each.label}: {', '.join(_cells(each, reports))}; {speed:.1f} × real time"
            print(line, file=sys.stderr, flush=True)
    return results


def plan(
    episodes: int,
    ablation: int,
    robots: Mapping[str, str],
    names: Sequence[str],
    others: int | None = None,
) -> tuple[list[Series], list[Series]]:
    """The series of both tables, for cells by the label of their robot.

    ``episodes`` are those of bgr with the first robot in each setting, ``others`` of each other
    task and robot (None: as many), ``ablation`` of each row of the second table (0: no such table).
    """
    test = tuple(episode_seeds.test_seeds(episodes))
    less = test if others is None else tuple(episode_seeds.test_seeds(others))
    first = [
        Series(
            f"{name}, {robot}, {setting}", cell, name, find_setting(setting), "ours",
            test if (name, robot) == ("bgr", next(iter(robots))) else less,
        )
        for name in names
        for robot, cell in robots.items()
        for setting in SETTINGS
    ]  # fmt: skip
    if ablation == 0:
        return first, []
    few = tuple(episode_seeds.test_seeds(ablation))
    cell = next(iter(robots.values()))
    second = [
        Series(f"{setting}: {label}{', ' + law + ' law' if law != 'ours' else ''}",
               cell, "bgr", each, law, few)
        for setting in SETTINGS
        for label, each in alone(find_setting(setting)).items()
        if label == "all together" or setting == STRONGEST
        for law in (("ours", "velocity", "paper") if label == "all together" else ("ours",))
    ]  # fmt: skip
    return first, second


def report(
    first: Sequence[tuple[Series, list[EpisodeReport]]],
    second: Sequence[tuple[Series, list[EpisodeReport]]],
    command: str,
) -> str:
    """Both tables as Markdown."""
    count = len(second[0][0].seeds) if second else 0
    lines = [
        f"# The phantom: tasks and settings\n\nWritten by `{command}`. Simulation, in process.\n",
        "RCM deviations and force at the trocar: largest of all samples of the commanded arm. "
        f"True: to the undisturbed trocar point. Settings: {', '.join(SETTINGS)}; once where "
        "equal.\n",
        "## Success of the scripted senders, test seeds\n",
        _HEAD.format("task, robot"),
        *first_rows(first).values(),
        "\nFailures:\n",
        *failures((series.label, done) for series, done in first),
    ]
    if not second:
        return "\n".join(lines) + "\n"
    lines += [
        f"\n## Each disturbance alone (bgr, {count} test seeds)\n",
        _HEAD.format("setting: disturbance"),
        *(f"| {each.label} | {' | '.join(_cells(each, done))} |" for each, done in second),
        "\nFailures:\n",
        *failures((series.label, done) for series, done in second),
    ]
    return "\n".join(lines) + "\n"


def _update(page: Path, done: Sequence[tuple[Series, list[EpisodeReport]]], command: str) -> None:
    """Put rows of the first table into a page."""
    text = rows_of_page.put(
        page.read_text(encoding="utf-8"),
        first_rows(done),
        failures((series.label, reports) for series, reports in done),
        command,
    )
    page.write_text(text, encoding="utf-8")


def main(words: Sequence[str] | None = None) -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(
        prog="surg_sim.envs.expert_evaluation", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--episodes", type=int, default=100, help="of each row of the first table")
    parser.add_argument("--others", type=int, help="the same of all but bgr with the first robot")
    parser.add_argument(
        "--ablation", type=int, default=10, help="of each row of the second table; 0: none"
    )
    parser.add_argument("--tasks", nargs="*", default=list(tasks.names()))
    parser.add_argument("--robots", nargs="+", choices=list(ROBOTS), default=list(ROBOTS))
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--out", type=Path, help="Markdown file; default: standard output")
    parser.add_argument(
        "--update", type=Path, metavar="PAGE", help="replace or add these rows; needs --ablation 0"
    )
    options = parser.parse_args(words)
    if options.update is not None and (options.ablation or options.out is not None):
        parser.error("--update takes --ablation 0 and no --out: it changes the first table only")
    robots = {name: ROBOTS[name] for name in options.robots}
    try:
        if options.update is not None:
            rows_of_page.check(options.update)
        first, second = plan(
            options.episodes, options.ablation, robots, options.tasks, options.others
        )
        results = run_all([*first, *second], options.jobs)
    except ValueError as error:
        print(f"surg_sim.envs.expert_evaluation: {error}", file=sys.stderr)
        return 2
    command = "python3 -m surg_sim.envs.expert_evaluation " + " ".join(
        sys.argv[1:] if words is None else words
    )
    n = len(first)
    done = list(zip(first, results[:n], strict=True))
    if options.update is not None:
        _update(options.update, done, command)
        return 0
    text = report(done, list(zip(second, results[n:], strict=True)), command)
    if options.out is None:
        print(text)
    else:
        options.out.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
