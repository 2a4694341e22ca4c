"""One task, setting and seed: one state hash, in one process and through the graph.

Through the graph everything takes another way: bytes, sockets, threads, five processes. What
arrives must be the same to the last bit, and nothing may depend on when.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from conftest import FULL
from helpers.graph import socket_jitter
from helpers.graph.two_arms import write_two_arms
from helpers.sim.nudge_task import LUCKY
from surg_cli.graph import episode_plans, episode_process, task_episode
from surg_cli.graph.episode_plans import Condition
from surg_cli.host import cells, paths
from surg_recording.episode import episode_reader as recorded
from surg_sim import tasks
from surg_sim.envs.cell_session import CellSession
from surg_sim.envs.episode_runner import EpisodeReport, run_episode
from surg_sim.envs.recorded_episode import RecordedSession
from surg_sim.envs.surg_env import SurgEnv

pytestmark = [pytest.mark.ros, pytest.mark.untimed]

HELPERS = paths.ROOT / "tests" / "helpers" / "sim"
SHORT = str(HELPERS / "short_bgr.py")
THREAD = str(HELPERS / "short_thread.py")
NUDGE = str(HELPERS / "nudge_task.py")
PUSHED = str(HELPERS / "pushed_bgr.py")


def in_process(cell: Path, task: str, setting: str, seed: int, law: str = "ours") -> EpisodeReport:
    # Made with another seed, and reset: what was compiled must not matter.
    return run_episode(CellSession(cell, task, setting, seed + 1, law=law), seed)


def through_the_graph(
    folder: Path, cell: Path, task: str, setting: str, seed: int, law: str = "ours"
) -> tuple[task_episode.Ended, dict[str, object]]:
    """Outcome and what the recording says of the simulator."""
    loaded = cells.load(cell)
    condition = Condition(setting, law)
    plan = episode_plans.make_plan(task, cell, loaded, [condition], seed, (), folder)
    plan = episode_plans.for_episode(plan, condition, seed, folder)
    ended = episode_process.run_episode(plan, lambda seconds, note: None)
    assert ended.played, ended.reason
    return ended, dict(recorded.read(folder / "episode").manifest["sim"])


def assert_same(
    folder: Path, cell: Path, task: str, setting: str, seed: int, law: str = "ours"
) -> None:
    ended, sim = through_the_graph(folder, cell, task, setting, seed, law)
    expected = in_process(cell, task, setting, seed, law)
    print(f"{task} {setting} {seed}: {sim['tick']} ticks, {expected.hash[:16]}, {ended.reason}")
    assert ended.played, ended.reason
    assert sim["deterministic"] is True
    assert sim["tick"] == round(expected.duration / 0.002)
    assert (ended.success, ended.reason) == (expected.success, expected.reason)
    assert sim["state_hash"] == expected.hash


def test_bowel_and_assistant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With every process held up at random, and breathing."""
    for name, value in socket_jitter.environment(5.0 if FULL else 0.3).items():
        monkeypatch.setenv(name, value)
    assert_same(tmp_path, cells.find("sim_two_arms"), SHORT, "in_vivo", 10_001)
    found = recorded.read(tmp_path / "episode")
    task, said = found.table("task_state"), found.table("command_assistant")
    ticks = task["tick"].tolist()
    assert ticks[:-1] == list(range(25, ticks[-2] + 1, 25))
    assert ticks[-1] == found.manifest["sim"]["tick"]
    assert task["done"].tolist() == [0] * (len(ticks) - 1) + [1]
    assert task["reason"][-1] and np.isfinite(task["task.nodes_35_2"]).all()
    # An action per look, joints and jaw, but for the look that ends the episode.
    for topic in ("servo_jp", "jaw/servo_jp"):
        assert (said["topic"] == topic).sum() == len(ticks) - 1
    assert_recorded_alike(found, tmp_path / "here")


WALL_CLOCK = {"receive_ns", "compute_us", "period_us", "overruns"}


def assert_recorded_alike(graph: recorded.Episode, folder: Path) -> None:
    """What is recorded in this process has the same rows as what came through the graph."""
    session = RecordedSession(cells.find("sim_two_arms"), SHORT, "in_vivo", 10_000)
    session.record(folder, 10_001)
    here = recorded.read(folder)
    names = [name for name in here.tables if name != "events"]
    assert {"cycle_PSM1", "cycle_ECM", "ground_truth_PSM1", "command_PSM1"} <= set(names)
    values = 0
    for name in names:
        one, other = here.table(name), graph.table(name)
        assert one.columns == other.columns
        for column in [c for c in one.columns if c not in WALL_CLOCK]:
            # A command has a row per topic and tick; the topics of one tick come in any order.
            rows = [
                t["topic"].argsort(kind="stable") if "topic" in t else ... for t in (one, other)
            ]
            a, b = one[column][rows[0]], other[column][rows[1]]
            if column in ("qx", "qy", "qz", "qw") or column.startswith("q_br"):
                # Normalised before it is recorded here, on its way to the arm there; of a matrix
                # by another algorithm.
                np.testing.assert_allclose(a, b, rtol=0, atol=1e-15, err_msg=f"{name}.{column}")
            else:
                np.testing.assert_array_equal(a, b, err_msg=f"{name}.{column}")
            values += len(one)
    print(f"{len(names)} tables, {values} values, the same in both ways")


@pytest.mark.full
def test_both_arms_commanded(tmp_path: Path) -> None:
    cell = write_two_arms(tmp_path / "cell", ("panda", "ur5e"))
    assert_same(tmp_path / "run", cell, NUDGE, "ex_vivo", 3)


@pytest.mark.full
def test_the_force_guard_acts_in_the_same_tick(tmp_path: Path) -> None:
    """A load on the trocar above a tightened limit: FAULT, in and out of ROS, and named."""
    tight = {"trocar_force_warn": 0.3, "trocar_force_fault": 0.45}
    cell = write_two_arms(tmp_path / "cell", limits=tight)
    ended, _ = through_the_graph(tmp_path / "run", cell, NUDGE, "phantom", LUCKY)
    assert (ended.success, ended.played) == (False, True)
    assert "PSM1 went into FAULT" in ended.reason and "force" in ended.reason
    cycle = recorded.read(tmp_path / "run" / "episode").cycle("PSM1")
    states: list[int] = []
    session = CellSession(cell, NUDGE, "phantom", LUCKY)
    run_episode(session, LUCKY, watch=lambda t: states.append(int(t.outputs["PSM1"].state)))
    fault = 3
    n = min(len(states), len(cycle))
    assert fault in states[:n] and states[:n] == cycle["state"][:n].tolist()
    print(f"FAULT at tick {states.index(fault) + 1}, here and there")


@pytest.mark.full
def test_the_jaws_feel_the_same_here_and_there(tmp_path: Path) -> None:
    """A push of 6 N on the jaws: PAUSED 51 cycles after the first sample, in and out of ROS."""
    cell = cells.find("sim_two_arms")
    through_the_graph(tmp_path / "run", cell, PUSHED, "phantom", 10_001)
    cycle = recorded.read(tmp_path / "run" / "episode").cycle("PSM1")
    states: list[int] = []
    session = CellSession(cell, PUSHED, "phantom", 10_001)
    run_episode(session, 10_001, watch=lambda t: states.append(int(t.outputs["PSM1"].state)))
    paused, n = 2, min(len(states), len(cycle))
    assert paused in states[:n] and states[:n] == cycle["state"][:n].tolist()
    print(f"PAUSED at tick {states.index(paused) + 1}, here and there")


@pytest.mark.full
def test_a_thread_in_the_jaws(tmp_path: Path) -> None:
    """In a cell of one arm: 31 point masses that swing."""
    assert_same(tmp_path, cells.find("sim_ur5e"), THREAD, "in_vivo", 10_001)


TASKS = ["bgr", "pick_and_place", "endoscope_guidance", "needle_driving", "thread_in_hole"]


@pytest.mark.full
@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("cell", ["sim_two_arms", "sim_two_arms_panda"])
@pytest.mark.parametrize("setting", ["phantom", "ex_vivo", "in_vivo"])
def test_whole_episodes(tmp_path: Path, task: str, cell: str, setting: str) -> None:
    assert task in tasks.names()
    assert_same(tmp_path, cells.find(cell), task, setting, 10_002)


@pytest.mark.full
@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("cell", ["sim_two_arms", "sim_two_arms_panda"])
@pytest.mark.parametrize("setting", ["phantom", "ex_vivo", "in_vivo"])
def test_gymnasium_ends_at_the_same_hash(task: str, cell: str, setting: str) -> None:
    expected = in_process(cells.find(cell), task, setting, 10_002)
    env = SurgEnv(task, cell=cell, setting=setting)
    env.reset(seed=10_002)
    ended = late = False
    while not (ended or late):
        _, _, ended, late, info = env.step(env.expert_action())
    print(f"{task} {cell} {setting}: {env.session.hash[:16]}")
    assert (info["success"], info["reason"]) == (expected.success, expected.reason)
    assert env.session.hash == expected.hash


@pytest.mark.full
@pytest.mark.parametrize("law", ["velocity", "paper"])
def test_the_other_laws(tmp_path: Path, law: str) -> None:
    assert_same(tmp_path, cells.find("sim_two_arms"), SHORT, "phantom", 10_003, law)
