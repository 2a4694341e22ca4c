"""Demonstrations in process, exported, read by the trainer: a tiny one, and what stands in it."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from helpers.policy.bgr_synthetic import train_state
from surg_cli.graph import episode_process
from surg_cli.graph import task_episode as cli_episode
from surg_cli.host import paths
from surg_cli.learning import rollouts as cli_rollouts
from surg_core.contract import STATE_KEY, TASK_STATE_KEY
from surg_learn.bgr import state_policy
from surg_learn.cloning import arm_columns
from surg_learn.recipes import PUSH_M
from surg_recording import datasets
from surg_recording.episode import episode_reader
from surg_recording.metrics import unsafe_commands
from surg_sim.envs import demonstrations, policy_rollouts
from surg_sim.envs.cell_session import CellSession
from surg_sim.envs.episode_runner import run_episode
from surg_sim.envs.recorded_episode import RecordedSession
from surg_sim.envs.surg_env import SurgEnv
from surg_sim.physics import cell_files
from surg_sim.tasks.bgr import bgr_definition as defined
from surg_sim.tasks.perturbed_sender import PerturbedExpert
from surg_sim.tasks.pick_and_place.pick_and_place_task import PickAndPlace
from surg_sim.tasks.scripted_arm import ArmExpert

SHORT = str(paths.ROOT / "tests" / "helpers" / "sim" / "short_bgr.py")
SEEDS = (10_000, 10_001)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two short recordings; the second one's hand is pushed about."""
    out = tmp_path_factory.mktemp("demonstrations")
    session = RecordedSession(cell_files.find("sim_two_arms"), SHORT)
    for seed, spread in zip(SEEDS, (0.0, 0.003), strict=True):
        session.reset(seed)
        experts = dict(session.task.experts(session.cell, seed))
        robot = experts["expert"]
        assert isinstance(robot, ArmExpert)
        if spread:
            experts["expert"] = PerturbedExpert(robot, seed, spread)
        session.record(out / str(seed), seed, experts, shake=spread)
    return out


@pytest.fixture(scope="module")
def exported(recorded: Path) -> Path:
    """Both as one dataset. Cut short, they solved no task: only the label makes them successes."""
    for seed in SEEDS:
        file = recorded / str(seed) / "manifest.json"
        manifest = json.loads(file.read_text("utf-8"))
        manifest["result"] = {"success": True}
        file.write_text(json.dumps(manifest), "utf-8")
    options = datasets.ExportOptions(splits={"train": 1.0}, executor="serial")
    out = recorded.with_name("dataset")
    report = datasets.load("lerobot").write([recorded], out, options)
    assert report.ok and report.recordings == 2
    return out


def test_a_disturbed_hand_begins_where_the_arm_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """A first pose far from it is refused; these seeds had drawn one, and nothing moved."""
    monkeypatch.setattr(PickAndPlace, "time_limit", 3.0)
    session = CellSession(cell_files.find("sim_ur5e"), "pick_and_place")
    refused: list[int] = []
    for seed in (10_021, 10_061, 10_077):
        hand = session.task.experts(session.cell, seed)["expert"]
        assert isinstance(hand, ArmExpert)
        hands = {"expert": PerturbedExpert(hand, seed, PUSH_M)}
        run_episode(session, seed, hands, lambda tick: refused.append(tick.outputs["PSM1"].refused))
        assert refused[-1] == 0


def test_the_phases_of_a_real_task_are_stages_in_words(recorded: Path) -> None:
    found = episode_reader.read(recorded / str(SEEDS[0]))
    assert found.manifest["run"]["instruction"] == defined.INSTRUCTION
    names = [stage["name"] for stage in found.stages]
    assert names == list(defined.PHASES[: len(names)]) and len(names) >= 2
    state = found.table("task_state")
    for stage in found.stages:
        assert stage["text"] == defined.STAGES[stage["name"]]
        inside = (state["stamp_ns"] >= stage["begin_ns"]) & (state["stamp_ns"] < stage["end_ns"])
        assert inside.any() and set(state["phase"][inside]) == {stage["name"]}


def test_an_action_is_what_the_expert_said_at_that_look(exported: Path) -> None:
    """The dataset's rows against the environment, driven by the same expert: no row early or late.

    Without cameras the grid stands on the looks of the task; one that stood on the commands, a
    tick later, would put the answer to the next look beside each observation.
    """
    dataset = train_state.read(exported)
    shown = dataset.episodes["train"][0]
    env = SurgEnv(SHORT)
    names = policy_rollouts.names(env)
    assert dataset.names[arm_columns.STATE] == names[STATE_KEY]
    assert dataset.names[arm_columns.TASK] == names[TASK_STATE_KEY]
    observation, _ = env.reset(seed=SEEDS[0])
    compared = 0
    for step in range(len(shown.state)):
        seen = policy_rollouts.observe(env, observation)
        action = env.expert_action()
        # The recording's rcm frame is the one that was measured at homing: micrometres away.
        np.testing.assert_allclose(shown.state[step], seen[STATE_KEY], atol=2e-5)
        np.testing.assert_allclose(shown.task[step], seen[TASK_STATE_KEY], atol=1e-5)
        if step:  # the jaw's first command comes with the second look
            np.testing.assert_allclose(shown.action[step, :4], action[:4], atol=2e-5)
        observation, _, ended, late, _ = env.step(action)
        compared += 1
        assert not ended
        if late:
            break
    print(f"{compared} frames")
    assert compared > 50


def test_no_demonstration_is_unsafe_pushed_or_not(recorded: Path) -> None:
    paths_of = []
    for seed in SEEDS:
        found = episode_reader.read(recorded / str(seed))
        assert found.complete and found.manifest["seed"] == seed
        assert {
            arm: [r for r in unsafe_commands.examine(found, arm) if r.cycles] for arm in found.arms
        } == {
            "PSM1": [],
            "ECM": [],
        }
        cycle = found.cycle("PSM1")
        paths_of.append(cycle.vector("p_goal")[cycle["command"] == 1][::25])
    spreads = [float(np.abs(np.diff(p, n=3, axis=0)).max()) for p in paths_of]
    print(f"third differences of the goals, calm and pushed: {spreads[0]:.5f}, {spreads[1]:.5f} m")
    assert spreads[1] > 1.5 * spreads[0]


def test_training_reads_it_and_is_the_same_twice(exported: Path, tmp_path: Path) -> None:
    for name in ("a.npz", "b.npz"):
        words = [str(exported), "--out", str(tmp_path / name), "--steps", "30", "--seed", "3"]
        assert train_state.main(words) == 0
    one, two = (state_policy.Policy.load(tmp_path / name) for name in ("a.npz", "b.npz"))
    assert one.hash == two.hash
    assert one.about["options"]["seed"] == 3


def test_what_is_recorded_is_not_played_again(
    recorded: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = demonstrations.DemonstrationPlan(
        recorded, cell_files.find("sim_two_arms"), SHORT, shake=0.003
    )
    assert demonstrations.play(plan, SEEDS) == []
    torn = recorded / f"{SEEDS[1]}{episode_reader.PARTIAL}"
    plan.folder(SEEDS[1]).rename(torn)
    try:
        assert [plan.done(seed) for seed in SEEDS] == [True, False]
    finally:
        torn.rename(plan.folder(SEEDS[1]))


def test_with_pictures_each_episode_has_the_look_of_its_seed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a graph; without pictures one scene serves them all."""
    looks: list[int] = []

    class Fake:
        def __init__(self, cell: Path, task: str, setting: str, seed: int, *how: object) -> None:
            looks.append(seed)

        reset = close = record = lambda *arguments, **words: None

    monkeypatch.setattr(demonstrations, "RecordedSession", Fake)
    monkeypatch.setattr(demonstrations, "_sessions", {})
    for cameras, wanted in (((), [5]), (("left",), [5, 6, 7])):
        looks.clear()
        plan = demonstrations.DemonstrationPlan(tmp_path, tmp_path, SHORT, cameras=cameras)
        for seed in (5, 6, 7):
            with contextlib.suppress(AttributeError):  # of a task that is not there
                demonstrations._play_one((plan, seed, 0))
        assert looks == wanted


def test_a_roll_out_is_told_from_what_its_process_left(recorded: Path, tmp_path: Path) -> None:
    """Verdict, deviations, smoothness, the server's counts, unsafe commands of the recording."""
    status = {
        "rejected": 0,
        "clipped": 1,
        "late": 2,
        "obs_age_ms": {"p50": 50.0, "p99": 50.0},
        "round_trip_ms": {"p50": 0.7, "p99": 3.0},
    }
    ended = cli_episode.Ended(False, "time limit", "grasp", 3.5, True, 2.0, status)
    shutil.copytree(recorded / str(SEEDS[0]), tmp_path / "episode")
    file = tmp_path / cli_episode.OUTCOME
    file.write_text(json.dumps(dataclasses.asdict(ended)), "utf-8")
    plan = SimpleNamespace(seed=SEEDS[0], setting="phantom", law="ours", out=tmp_path)
    found = cli_rollouts.describe(plan, episode_process.read_outcome(tmp_path, ""))
    rollout = json.loads(json.dumps(found["rollout"]))
    assert (rollout["success"], rollout["reason"], rollout["played"]) == (False, "time limit", True)
    assert {name: rollout[name] for name in status} == status
    assert rollout["unsafe"]["commands"] == 0 and rollout["unsafe"]["cycles"] > 3000
    assert 0.0 < rollout["rcm_mean_mm"] < rollout["rcm_max_mm"] < 0.3
    assert rollout["sparc"] < 0.0 and rollout["ldlj"] < 0.0
    for waited, sessions in ((0, 1), (1, 1), (0, 2)):  # ticks without an answer: of this machine
        counts = {**status, "waited": waited, "sessions": sessions}
        late = dataclasses.replace(ended, policy=counts)
        entry, _ = episode_process.measure(plan, late, lambda *_: None)
        assert entry["deterministic"] is ((waited, sessions) == (0, 1))
    # A process that left nothing: not played, never a success, and nothing is called safe.
    nothing = tmp_path / "nothing"
    ended = episode_process.read_outcome(nothing, "the graph did not come up")
    plan.out = nothing
    lost = cli_rollouts.describe(plan, ended)
    assert not lost["rollout"]["played"] and not lost["rollout"]["success"]
    assert "the graph did not come up" in lost["rollout"]["reason"]
    assert lost["rollout"]["unsafe"] is None
