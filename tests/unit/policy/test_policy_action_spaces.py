"""What was learned can be served: export in an action space, replay as a policy, same commands."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.policy.policy_bench import ARM, Bench
from helpers.recording import datasets_synthetic
from surg_core.contract import ACTION_SPACES
from surg_policy_bridge.server.chunk_queue import plan_shares
from surg_policy_bridge.server.policy_arm import Target
from surg_policy_client.action_spec import ActionSpec
from surg_policy_client.observation import Observation
from surg_policy_client.policies import replay
from surg_policy_client.spec import Spec
from surg_recording import datasets
from surg_recording.datasets import ExportOptions

STEPS = 25


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One recording in every action space."""
    root = tmp_path_factory.mktemp("spaces")
    recording = datasets_synthetic.record(root / "episode", 1, 1.4, ())
    options = ExportOptions(executor="serial", splits={"train": 1.0})
    for space in ACTION_SPACES:
        chosen = dataclasses.replace(options, action_space=space)
        assert datasets.load("lerobot").write([recording], root / space, chosen).ok
    return {space: root / space for space in ACTION_SPACES}


def bench_in(space: str, **settings: Any) -> Bench:
    """A policy that runs in an action space; ``settings`` are those of `Bench`."""
    bench = Bench(**settings)
    bench.start(wants=Spec(action=ActionSpec.of_space(space, [ARM])).to_map())
    return bench


def rows(folder: Path) -> np.ndarray:
    """(frames, 5) actions of a data set."""
    policy = replay.load(folder)
    return policy._rows[:-1]


def replayed(folder: Path, start: np.ndarray) -> np.ndarray:
    """(STEPS, 5) targets that the arm got, from its set-point ``start``."""
    bench, policy = Bench(), replay.load(folder)
    bench.arm.set(Target.of(start))
    bench.start(wants=policy.wants.to_map())
    served = Spec.from_map(bench.of("WELCOME")[-1].head["spec"])
    policy.reset("do it", 1)
    for step in range(-1, STEPS):
        bench.ping()
        bench.tick()
        bench.observe()
        seen = Observation.of(bench.of("OBS")[-1], served)
        if step < 0:  # the stream begins at rest: its first step may be 2 mm only
            bench.act([seen.held_action()])
        elif step % 4 == 0:  # chunks overlap: each refers to the step before it
            bench.act(policy.act(seen))
        assert bench.execute() is not None, bench.server.reason
        bench.now += 50_000_000
        bench.step += 1
    return np.array([target.row for _, target in bench.sent[1:]])


@pytest.mark.parametrize("space", ACTION_SPACES)
def test_the_arm_gets_the_recorded_commands(exported: dict[str, Path], space: str) -> None:
    absolute = rows(exported["absolute"])
    start = absolute[0].copy()
    start[:4] -= rows(exported["relative"])[0][:4]
    sent = replayed(exported[space], start)
    np.testing.assert_allclose(sent, absolute[:STEPS], atol=2e-7)
    assert np.ptp(sent[:, 0]) > 0.01, "it moved"


@pytest.mark.parametrize("space", ACTION_SPACES)
def test_a_data_set_names_its_action_space(exported: dict[str, Path], space: str) -> None:
    info = json.loads((exported[space] / "meta/info.json").read_text())
    feature = info["features"]["action"]
    assert info["action_space"] == space
    assert feature["names"] == [f"PSM1/{name}" for name in ACTION_SPACES[space]]
    assert feature["info"]["units"] == list(ACTION_SPACES[space].values())
    stated = json.loads((exported[space] / "surg_export.json").read_text())
    assert stated["options"]["action_space"] == space


@pytest.mark.parametrize("space", ACTION_SPACES)
def test_holding_keeps_the_set_point_in_every_space(space: str) -> None:
    bench = bench_in(space)
    bench.arm.set(Target(np.array([0.01, -0.02, 0.11]), 0.3, 0.4))
    bench.tick()
    bench.observe()
    served = Spec.from_map(bench.of("WELCOME")[-1].head["spec"])
    bench.act([Observation.of(bench.of("OBS")[-1], served).held_action()] * 3)
    target = bench.execute()
    assert target is not None
    np.testing.assert_allclose(target.row, [0.01, -0.02, 0.11, 0.3, 0.4], atol=1e-7)


def test_a_clipped_step_is_what_the_next_change_refers_to() -> None:
    bench = bench_in("relative", clip=("step", "jaw"))
    jaw = bench.arm.view.jaw_set
    at = []
    for change in (0.001, 0.006, 0.012, 0.030, 0.012):
        target = bench.period([[change, 0, 0, 0, jaw]])
        assert target is not None, bench.server.steps.judged[-1]
        at.append(target.p[0])
    np.testing.assert_allclose(at[:3], [0.001, 0.007, 0.019], atol=1e-12)
    assert at[2] + 0.012 < at[3] < at[2] + 0.020, "clipped"
    assert at[4] == pytest.approx(at[3] + 0.012)


def test_changes_that_add_up_to_infinity_are_refused_at_once() -> None:
    bench = bench_in("relative", clip=("step",))
    assert bench.period([[0, 0, 0, 1.7e308, bench.arm.view.jaw_set]] * 3) is None
    (told,) = bench.of("ACK")[-1].head["rejected"]
    assert told["rule"] == "not_finite" and bench.server.state.value == "RUNNING"


def test_a_change_refers_to_the_step_before_it_even_if_that_is_still_queued() -> None:
    bench = bench_in("relative")
    jaw = bench.arm.view.jaw_set
    bench.tick()
    bench.observe()
    bench.act([[0.001, 0, 0, 0, jaw]] * 3)
    at = []
    for number in range(4):
        bench.ping()
        bench.tick()
        bench.observe()
        if number == 0:
            bench.act([[0, 0.002, 0, 0, jaw]] * 2, first=bench.step + 3)
        target = bench.execute()
        assert target is not None
        at.append(target.p[:2].tolist())
        bench.now += 50_000_000
        bench.step += 1
    expected = [[0.001, 0], [0.002, 0], [0.002, 0.002], [0.002, 0.004]]
    np.testing.assert_allclose(at, expected, atol=1e-12)


def test_after_a_gap_a_change_refers_to_the_set_point_as_at_the_start() -> None:
    """The controller stops the arm of a silent stream; it need not be where it was sent."""
    bench = bench_in("relative")
    jaw = bench.arm.view.jaw_set
    change = [0.001, 0, 0, 0, jaw]
    for _ in range(3):
        assert bench.period([change]) is not None
    for _ in range(4):
        assert bench.period() is None
    bench.arm.set(Target(bench.arm.view.p_set + np.array([0, 0.004, 0]), 0.0, jaw))
    rest = bench.arm.view.p_set.copy()
    target = bench.period([change])
    assert target is not None, bench.server.steps.judged[-1]
    np.testing.assert_allclose(target.p, rest + np.array([0.001, 0, 0]), atol=1e-12)
    # A chunk that is late by a row: its first change is that of the step just sent.
    bench.ping()
    bench.tick()
    bench.observe()
    bench.act([change] * 2, first=bench.step)
    target = bench.execute()
    assert target is not None
    joined = 0.001 * (2.0 - plan_shares(1)[0])  # it is late, and the arm stood
    np.testing.assert_allclose(target.p, rest + np.array([joined, 0, 0]), atol=1e-12)
