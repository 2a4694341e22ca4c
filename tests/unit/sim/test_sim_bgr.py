"""Bowel grasping and retraction: what is a success, and everything that must be none."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import mujoco
import numpy as np
import pytest

from surg_core.arm_view import TipPose
from surg_sim.envs.cell_session import CellSession, Tick
from surg_sim.envs.episode_runner import EpisodeReport, run_episode
from surg_sim.physics import cell_files
from surg_sim.tasks import episode_seeds
from surg_sim.tasks.bgr import bgr_definition, bgr_task
from surg_sim.tasks.bgr.bgr_expert import OPEN, AssistantExpert, RobotExpert
from surg_sim.tasks.scripted_sender import Expert

SEED = episode_seeds.TEST[0]


@pytest.fixture(scope="module")
def session() -> CellSession:
    """One compiled scene for all tests; one arm is enough and faster."""
    return CellSession(cell_files.find("sim_ur5e"), "bgr")


def play(
    session: CellSession,
    robot: Expert | None = None,
    assistant: Expert | None = None,
    limit: float = 20.0,
    watch: Callable[[Tick], None] | None = None,
) -> EpisodeReport:
    session.task.time_limit = limit  # type: ignore[misc]
    experts: dict[str, Expert] = {
        "expert": robot or RobotExpert(session.cell, SEED),
        "assistant": assistant or AssistantExpert(SEED),
    }
    return run_episode(session, SEED, experts, watch)


@pytest.mark.parametrize(
    ("force", "state", "cycles"), [(4.9, 1, 0), (6.0, 2, 51), (9.0, 3, 1), (np.nan, 3, 1)]
)
def test_a_force_on_the_jaws_stops_the_arm(
    session: CellSession, monkeypatch: pytest.MonkeyPatch, force: float, state: int, cycles: int
) -> None:
    """F25: 6 N pauses after 0.1 s, 9 N and nonsense stop at once, 4.9 N is allowed.

    The sample of tick k, every fifth, counts from cycle k + 1 on.
    """
    begin = 500  # it is enabled and under way by then
    monkeypatch.setattr(
        session.task,
        "jaw_force",
        lambda arm: np.array([0.0, 0.0, force if session.world.tick >= begin else 0.0]),
    )
    states: list[int] = []
    play(session, limit=1.5, watch=lambda tick: states.append(int(tick.outputs["PSM1"].state)))
    assert states[begin - 1] == 1, "ENABLED in the cycle that the first sample follows"
    changes = [k for k in range(begin, len(states)) if states[k] != 1]
    if cycles == 0:
        assert not changes
    else:
        assert (changes[0] - begin + 1, states[changes[0]]) == (cycles, state)


def test_the_scripted_pair_succeeds_keeps_the_pivot_and_feels_the_tissue() -> None:
    """What reaches the force guard is the tissue's force, turned into the arm's base frame."""
    session = CellSession(cell_files.find("sim_ur5e"), "bgr", "in_vivo")
    task = session.task
    assert isinstance(task, bgr_task.Bgr)
    R_WB = np.asarray(session.cell.arms["PSM1"].X_WB)[:3, :3]
    phases: list[str] = []
    felt: list[float] = []

    def watch(tick: Tick) -> None:
        if tick.verdict.phase not in phases:
            phases.append(tick.verdict.phase)
        force = session.world.tip_force("PSM1")
        assert force is not None
        assert np.allclose(R_WB @ force, task.grasps["PSM1"].force, atol=1e-12)
        felt.append(float(np.linalg.norm(force)))

    report = play(session, watch=watch)
    arm = report.arms["PSM1"]
    print(f"{report.duration:.1f} s, kinematic {arm.kinematic}, true {arm.true}")
    print(f"largest force on the jaws {max(felt):.2f} N")
    assert report.success, report.reason
    assert bgr_definition.TAUT < max(felt) < session.cell.arms["PSM1"].limits.tip_force_soft
    assert tuple(phases) == bgr_task.PHASES
    assert arm.kinematic.mean < 0.05e-3
    assert arm.kinematic.max < 0.3e-3
    # The end as the definition has it, from ground truth.
    robot, other = task.held(bgr_task.ROBOT), task.held(bgr_task.ASSISTANT)
    assert robot is not None and other is not None
    assert abs(robot - task.target) <= bgr_definition.RIGHT
    assert abs(robot - other) >= bgr_definition.LEAST_APART
    first, last = sorted((robot, other))
    assert task.bowel.tensions[first:last].min() >= bgr_definition.TAUT
    assert task.view.sees(task.bowel.nodes[first : last + 1])


def test_nobody_does_anything_is_a_failure(session: CellSession) -> None:
    session.task.time_limit = 2.0  # type: ignore[misc]
    report = run_episode(session, SEED, experts={})
    assert (report.success, report.reason) == (False, "time limit of 2 s in phase 'point'")


def test_no_grasp_is_a_failure(session: CellSession) -> None:
    class Idle(RobotExpert):
        def script(self) -> Iterator[None]:
            yield from self.wait(100.0)

    report = play(session, robot=Idle(session.cell, SEED), limit=4.0)
    assert (report.success, report.reason) == (False, "time limit of 4 s in phase 'grasp'")


@pytest.mark.full
def test_too_late_is_a_failure_though_all_was_right(session: CellSession) -> None:
    report = play(session, limit=8.0)
    assert (report.success, report.reason) == (False, "time limit of 8 s in phase 'retract'")


def test_the_wrong_place_is_a_failure(session: CellSession) -> None:
    class Astray(RobotExpert):
        def act(self, view):  # type: ignore[no-untyped-def]
            view.task["target"] += 3.0
            return super().act(view)

    report = play(session, robot=Astray(session.cell, SEED))
    assert not report.success
    assert report.reason.startswith("wrong place: node")


def test_letting_go_is_a_failure(session: CellSession) -> None:
    class Careless(RobotExpert):
        def squeeze(self, angle: float, seconds: float) -> Iterator[None]:
            yield from super().squeeze(angle, seconds)
            yield from super().squeeze(OPEN, seconds)

    report = play(session, robot=Careless(session.cell, SEED))
    assert (report.success, report.reason) == (False, "the robot lost its grasp")


@pytest.mark.full
def test_the_assistant_letting_go_is_a_failure(session: CellSession) -> None:
    class Careless(AssistantExpert):
        def act(self, view):  # type: ignore[no-untyped-def]
            action = super().act(view)
            if view.phase in ("retract", "still"):
                self.jaw = OPEN
            return action

    report = play(session, assistant=Careless(SEED))
    assert (report.success, report.reason) == (False, "the assistant lost its grasp")


@pytest.mark.full
def test_an_instrument_that_keeps_moving_is_a_failure(session: CellSession) -> None:
    class Restless(RobotExpert):
        def act(self, view):  # type: ignore[no-untyped-def]
            action = super().act(view)
            commands = action.arms.get("PSM1")
            pose = commands.servo_cp if commands is not None else None
            if view.phase == "still" and commands is not None and pose is not None:
                up = 0.002 * np.sin(2 * np.pi * view.tick / 500.0)
                commands.servo_cp = TipPose(pose.p + np.array([0.0, 0.0, up]), pose.roll)
            return action

    report = play(session, robot=Restless(session.cell, SEED), limit=13.0)
    assert (report.success, report.reason) == (False, "time limit of 13 s in phase 'still'")


def test_unstable_physics_fails_with_the_cause_and_the_next_episode_is_clean(
    session: CellSession, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes MUJOCO_LOG.TXT where it stands
    clean = play(session, limit=1.2)

    def break_it(tick: Tick) -> None:
        if tick.tick == 300:
            session.world.data.qvel[-1] = np.nan

    report = play(session, limit=1.2, watch=break_it)
    assert not report.success
    assert report.duration == pytest.approx(0.602)
    assert "not to be trusted" in report.reason
    again = play(session, limit=1.2)
    assert again.hash == clean.hash
    fresh = play(CellSession(cell_files.find("sim_ur5e"), "bgr"), limit=1.2)
    assert fresh.hash == clean.hash  # a new process would not see another world


def test_another_seed_is_another_episode(session: CellSession) -> None:
    session.task.time_limit = 0.1  # type: ignore[misc]
    first, second = (
        run_episode(session, seed, experts={}).hash for seed in episode_seeds.test_seeds(2)
    )
    assert first != second


def test_every_cannula_turns_with_its_shaft() -> None:
    """What a picture shows: no shaft passes beside the cannula in which it is."""
    session = CellSession(cell_files.find("sim_two_arms"), "bgr", visuals=True)
    model, data = session.world.model, session.world.data
    data.qpos[:] += np.random.default_rng(4).uniform(-0.05, 0.05, model.nq)
    mujoco.mj_kinematics(model, data)
    tips = {f"{arm}/sleeve": f"{arm}_tip" for arm in session.world.arms}
    for carrier, tip in {**tips, "assistant_pitch": "assistant_tip"}.items():
        body, end = model.body(carrier), model.body(tip).id
        s, at = data.xmat[end].reshape(3, 3)[:, 2], data.xpos[end]
        first = int(body.geomadr[0])
        cannula = [
            g for g in range(first, first + int(body.geomnum[0])) if model.geom_group[g] == 2
        ]
        assert len(cannula) == 4, carrier
        for geom in cannula:
            assert abs(data.geom_xmat[geom].reshape(3, 3)[:, 2] @ s) > 1.0 - 1e-9
            assert np.linalg.norm(np.cross(data.geom_xpos[geom] - at, s)) < 1e-6
