"""A policy for a wristed arm: six joints or the whole pose of the tip, as in the data set."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from helpers.policy.policy_bench import ARM, WRISTED, Bench
from helpers.recording import wristed_episode
from helpers.recording.wristed_episode import Truth
from surg_core.contract import ACTION_SPACES, WRISTED_ACTION_SPACES, WRISTED_STATE
from surg_policy_client.action_spec import ActionSpec
from surg_policy_client.observation import Observation
from surg_policy_client.policies import replay
from surg_policy_client.spec import Spec
from surg_sim.envs.surg_env import SurgEnv

Array = NDArray[np.float64]
STEPS = 40
TILTED = Rotation.from_rotvec([0.3, -0.2, 0.4])


def running(space: str, bench: Bench | None = None) -> tuple[Bench, Spec]:
    """A bench whose policy runs in an action space, at rest with a bent wrist."""
    bench = bench or Bench(path=WRISTED)
    wants = Spec(action=ActionSpec.of_space(space, [ARM], wristed=[ARM]))
    bench.hello(wants=wants.to_map())
    assert not bench.errors, bench.errors
    bench.tick()
    assert bench.server.enable(True, bench.now) == ""
    for _ in range(3):
        bench.tick()
    return bench, Spec.from_map(bench.of("WELCOME")[-1].head["spec"])


def pose(bench: Bench) -> tuple[Array, Rotation]:
    """Where the arm's tip is."""
    assert bench.arm.view.wrist is not None
    return bench.arm.view.p_BTip, Rotation.from_quat(bench.arm.view.wrist.q_RTip)


@pytest.mark.parametrize("space", ACTION_SPACES)
def test_the_arm_gets_the_recorded_poses(
    recorded: tuple[Path, Truth], exported: dict[str, Path], space: str
) -> None:
    absolute = replay.load(exported["absolute"])._rows
    start, policy = absolute[0], replay.load(exported[space])
    (turn,) = wristed_episode.recorded_at_the_end(recorded[0], "wrist_turn")
    bench, served = running(space, Bench(path=WRISTED, turn=turn))
    bench.arm.set(bench.arm.target_of(wristed_episode.tip_pose(start), float(start[7])))
    policy.reset("", 1)
    apart, turned = [], []
    for step in range(-1, STEPS):
        bench.ping()
        bench.tick()
        bench.observe()
        seen = Observation.of(bench.of("OBS")[-1], served)
        if step < 0:
            bench.act([seen.held_action()])
        elif step % 4 == 0:
            bench.act(policy.act(seen))
        assert bench.execute() is not None, bench.server.steps.judged[-1]
        bench.now += 50_000_000
        bench.step += 1
        if step >= 0:
            p, turn = pose(bench)
            apart.append(np.linalg.norm(p - absolute[step, :3]))
            turned.append((turn * Rotation.from_quat(absolute[step, 3:7]).inv()).magnitude())
    assert max(apart) < 2e-6 and max(turned) < 2e-5
    assert np.ptp(absolute[:STEPS, 3:7], axis=0).max() > 0.1, "it turned"


@pytest.mark.parametrize("space", ACTION_SPACES)
def test_holding_keeps_place_and_orientation(space: str) -> None:
    bench, served = running(space)
    row = np.array([0.01, -0.02, 0.11, *TILTED.as_quat(), 0.4])
    bench.arm.set(bench.arm.target_of(wristed_episode.tip_pose(row), 0.4))
    before = pose(bench)
    bench.tick()
    bench.observe()
    bench.act([Observation.of(bench.of("OBS")[-1], served).held_action()] * 3)
    assert bench.execute() is not None, bench.server.steps.judged[-1]
    after = pose(bench)
    assert np.abs(after[0] - before[0]).max() < 1e-7
    assert (after[1] * before[1].inv()).magnitude() < 1e-6


def test_what_the_wrist_cannot_do_is_refused_with_its_rule() -> None:
    bench, served = running("joint")
    bench.tick()
    bench.observe()
    held = Observation.of(bench.of("OBS")[-1], served).held_action()
    assert bench.period([held]) is not None
    for turn, rule in ((0.9, "step"), (2.5, "workspace")):
        row = held.copy()
        row[4] += turn
        assert bench.period([row]) is None
        (told,) = bench.of("ACK")[-1].head["rejected"]
        assert told["rule"] == rule and "wrist" in told["text"]
        assert bench.period([held]) is not None
    bent, _ = running("joint", Bench(path=WRISTED, clip=("step", "jaw")))
    bent.tick()
    bent.observe()
    assert bent.period([held]) is not None
    row[4] = held[4] + 0.9
    target = bent.period([row])
    assert target is not None and 0.05 < target.turns[0] - held[4] < 0.9, "clipped"


def test_a_pose_that_no_wrist_can_have_is_refused() -> None:
    bench, _ = running("absolute")
    sideways = Rotation.from_rotvec([0.0, np.pi / 2, 0.0]).as_quat()
    for q in (np.zeros(4), sideways):
        assert bench.period([[0.0, 0.0, 0.12, *q, 0.3]]) is None
        (told,) = bench.of("ACK")[-1].head["rejected"]
        assert told["rule"] in ("not_finite", "workspace")


def test_a_policy_for_a_straight_instrument_is_refused_by_its_columns() -> None:
    bench = Bench(path=WRISTED)
    bench.hello(wants=Spec(action=ActionSpec.of_space("absolute", [ARM])).to_map())
    ((_, code, text),) = bench.errors
    assert code == "spec" and "PSM1/roll" in text and "PSM1/qx" in text


def test_an_environment_takes_and_shows_the_whole_pose() -> None:
    env = SurgEnv("bgr", cell="sim_ur5e_wrist")
    assert env.action_names == [f"{ARM}/{name}" for name in WRISTED_ACTION_SPACES["absolute"]]
    assert env.state_names[: len(WRISTED_STATE)] == [f"{ARM}/{name}" for name in WRISTED_STATE]
    observation, _ = env.reset(seed=1)
    place = {name: i for i, name in enumerate(env.state_names)}

    def named(state: Array, *names: str) -> Array:
        return state[[place[f"{ARM}/{name}"] for name in names]]

    first = observation["state"]
    start = named(first, "set_x", "set_y", "set_z")
    turn = Rotation.from_quat(named(first, "set_qx", "set_qy", "set_qz", "set_qw"))
    jaw = named(first, "jaw")
    for k in range(1, 21):
        part = Rotation.from_rotvec(k / 20 * np.array([0.2, 0.3, 0.25])) * turn
        row = np.concatenate([start, part.as_quat(), jaw])
        observation, _, _, _, info = env.step(row)
    for _ in range(10):
        observation, _, _, _, info = env.step(row)
    assert info["refused"] == 0
    state = observation["state"]
    measured = Rotation.from_quat(named(state, "tip_qx", "tip_qy", "tip_qz", "tip_qw"))
    assert (measured * part.inv()).magnitude() < 0.01
    assert np.abs(named(state, "tip_x", "tip_y", "tip_z") - start).max() < 5e-4
    env.close()


@pytest.mark.parametrize("cell", ["sim_ur5e", "sim_ur5e_wrist"])
def test_an_environment_takes_every_action_space(cell: str) -> None:
    """The expert turns the needle the same way in all of them."""
    seen = {}
    for space in ACTION_SPACES:
        env = SurgEnv("needle_driving", cell=cell, space=space)
        known = WRISTED_ACTION_SPACES if cell.endswith("wrist") else ACTION_SPACES
        assert env.action_names == [f"{ARM}/{name}" for name in known[space]]
        observation, _ = env.reset(seed=20_000)
        states = [observation["state"]]
        for _ in range(STEPS):
            action = env.expert_action()
            assert env.action_space.contains(action)
            observation, _, _, _, info = env.step(action)
            states.append(observation["state"])
        assert info["refused"] == 0
        seen[space] = np.array(states)
        env.close()
    for space in ACTION_SPACES:
        np.testing.assert_allclose(seen[space], seen["absolute"], atol=1e-6, err_msg=space)
    assert np.ptp(seen["absolute"], axis=0).max() > 0.02, "it moved"
