"""Every task by its scripted senders, in every setting and with both robots: docs/results."""

from __future__ import annotations

import pytest

from helpers.results.results_page import ResultsPage
from surg_core.wilson import wilson_interval
from surg_sim import tasks
from surg_sim.envs.cell_session import CellSession
from surg_sim.envs.episode_runner import ArmReport, run_episode
from surg_sim.physics import cell_files
from surg_sim.physics.patient_settings import SETTINGS
from surg_sim.tasks import episode_seeds

ROBOTS = {"UR5e": "sim_two_arms", "Panda": "sim_two_arms_panda"}
"""Robot of the instrument, and the bundled cell with it."""
EPISODES = 100
PAGE = ResultsPage("phantom.md")


def measured(task: str, cell: str, setting: str) -> tuple[int, list[ArmReport]]:
    """Successes, and what the commanded arm did in each episode."""
    seeds = episode_seeds.test_seeds(EPISODES)
    session = CellSession(cell_files.find(cell), task, setting, seeds[0])
    reports = [run_episode(session, seed) for seed in seeds]
    arms = [report.arms[tasks.load(task).commanded[0]] for report in reports]
    return sum(report.success for report in reports), arms


@pytest.mark.full
@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("task", tasks.names())
def test_every_task_in_every_setting(task: str, robot: str) -> None:
    rows = []
    for setting in SETTINGS:
        good, arms = measured(task, ROBOTS[robot], setting)
        low, high = wilson_interval(good, EPISODES)
        most = {
            name: max(getattr(arm, name).max for arm in arms)
            for name in ("kinematic", "true", "force")
        }
        rows.append((
            f"{good}/{EPISODES}", f"{100 * low:.0f}–{100 * high:.0f}",
            f"{1e3 * most['kinematic']:.3f}", f"{1e3 * most['true']:.3f}", f"{most['force']:.3f}",
        ))  # fmt: skip
        if robot == "UR5e":
            assert low >= 0.9, setting
        assert most["kinematic"] < 1e-3, setting
        if setting == "phantom":
            assert max(arm.kinematic.mean for arm in arms) < 0.05e-3
            assert most["kinematic"] < 0.3e-3
    columns = zip(*rows, strict=True)
    cells = (each[0] if len(set(each)) == 1 else ", ".join(each) for each in columns)
    PAGE.note(f"{task}, {robot}", None, " | ".join(cells))
