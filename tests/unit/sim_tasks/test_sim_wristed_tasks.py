"""Tasks with a wristed instrument: its needle beside a straight one's, judged by the simulator."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from conftest import FULL
from helpers.results.results_page import ResultsPage
from surg_sim.arrays import Array
from surg_sim.envs.cell_session import CellSession, Tick
from surg_sim.envs.episode_runner import run_episode
from surg_sim.physics import cell_files
from surg_sim.physics.patient_settings import SETTINGS
from surg_sim.tasks import episode_seeds
from surg_sim.tasks.needle_driving.curved_needle import arc, tangent
from surg_sim.tasks.needle_driving.needle_board import THICKNESS
from surg_sim.tasks.needle_driving.needle_driving_task import ARM, NeedleDriving

PAGE = ResultsPage("wrist.md")
CELLS = {"straight": "sim_ur5e", "wrist": "sim_ur5e_wrist"}
EPISODES = 20 if FULL else 2
NEAR = 0.005
"""[m] from a hole's axis: the point is at this hole, or its rim."""
ARC = np.linspace(np.pi / 2, np.pi, 200)
"""[rad] The half of the needle with its point: the other one meets the plane of the disc, too."""
LEAN = np.radians(7.0)
"""[rad] mean of the largest of wristed needles: 0.5 mm of the hand are 2.5 degrees."""


@dataclass
class Needle:
    """What the simulator says of a needle on its way through the asked hole."""

    session: CellSession
    entry: float = 0.0  # [N] largest across the hole's axis, point in the disc
    exit: float = 0.0  # [N] the same, point behind it
    lean: float = 0.0  # [rad] largest of the needle in the disc's middle against the hole's axis
    wrist: list[Array] = field(default_factory=list)  # pitch and yaw [rad], point at or behind it

    def watch(self, _: Tick) -> None:
        """Every tick."""
        task = self.session.task
        assert isinstance(task, NeedleDriving)
        X_WHole = task.board.poses[task.asked]
        x, y, z = X_WHole[:3, :3].T @ (task.point - X_WHole[:3, 3])
        if z < -THICKNESS / 2 or np.hypot(x, y) > NEAR:
            return
        force = task.jaw_force(ARM)
        assert force is not None
        across = float(np.linalg.norm((X_WHole[:3, :3].T @ force)[:2]))
        measured = self.session.world.state(ARM).wrist
        if measured is not None:
            self.wrist.append(measured[:2])
        if z < THICKNESS / 2:
            self.entry = max(self.entry, across)
            return
        self.exit = max(self.exit, across)
        R = X_WHole[:3, :3].T @ task.state()["X_WNeedle"][:3, :3]
        centre = X_WHole[:3, :3].T @ (task.state()["X_WNeedle"][:3, 3] - X_WHole[:3, 3])
        depths = centre[2] + np.array([arc(angle) for angle in ARC]) @ R[2]
        through = ARC[np.abs(depths).argmin()]
        self.lean = max(self.lean, float(np.arccos(min((R @ tangent(through))[2], 1.0))))


def driven(cell: str, setting: str) -> list[Needle]:
    """The needles of the expert's episodes, which all succeed."""
    seeds = episode_seeds.test_seeds(EPISODES)
    session = CellSession(cell_files.find(cell), "needle_driving", setting, seeds[0])
    needles = []
    for seed in seeds:
        needle = Needle(session)
        report = run_episode(session, seed, watch=needle.watch)
        assert report.success, (seed, report.reason)
        assert report.arms[ARM].kinematic.max < 0.3e-3
        needles.append(needle)
    return needles


def figures(name: str, needles: list[Needle]) -> str:
    """Mean and largest [N, degrees]."""
    values = np.array([getattr(needle, name) for needle in needles])
    if name == "lean":
        return f"{np.degrees(values.mean()):.1f}/{np.degrees(values.max()):.1f}"
    return f"{values.mean():.2f}/{values.max():.2f}"


@pytest.mark.parametrize("setting", SETTINGS if FULL else ["phantom"])
def test_a_wrist_turns_the_needle_through_its_arc(setting: str) -> None:
    found = {held: driven(cell, setting) for held, cell in CELLS.items()}
    cells = [
        ", ".join(figures(name, needles) for needles in found.values())
        for name in ("entry", "exit", "lean")
    ]
    PAGE.note(setting, None, " | ".join(cells))
    straight, wristed = found["straight"], found["wrist"]
    leans = [np.mean([needle.lean for needle in needles]) for needles in (straight, wristed)]
    assert leans[1] < LEAN and leans[1] < 0.6 * leans[0]
    turned = [np.ptp(needle.wrist, axis=0).max() for needle in wristed]
    assert max(turned) > 0.15, "the wrist turned while the needle was in the hole"
    most = [
        max(max(needle.entry, needle.exit) for needle in needles) for needles in (straight, wristed)
    ]
    assert most[1] < most[0]


@pytest.mark.parametrize("held", CELLS)
def test_bgr_goes_with_either_instrument(held: str) -> None:
    session = CellSession(cell_files.find(CELLS[held]), "bgr", "phantom")
    for seed in episode_seeds.test_seeds(EPISODES):
        report = run_episode(session, seed)
        assert report.success, (seed, report.reason)
        assert report.arms[ARM].kinematic.max < 0.3e-3
