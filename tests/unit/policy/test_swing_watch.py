"""Commands that swing are named; motions on purpose are not."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import pytest

from helpers.policy.policy_bench import spec
from helpers.results.policy_results import note
from surg_core.contract import ARM_STATE, SECOND_NS, STATE_KEY, STEP_NS
from surg_policy_bridge.server.swing_watch import TURNS, SwingWatch
from surg_policy_client import Observation
from surg_policy_client.observation import RCM
from surg_policy_client.policies import hold, scripted, skeleton
from surg_sim.envs.surg_env import SurgEnv
from surg_sim.tasks import names


def rows_until_named(x: np.ndarray) -> int | None:
    """After how many rows of these x [mm] a swing is named; None: never."""
    watch = SwingWatch(["PSM1"])
    for k, value in enumerate(x):
        watch.take(np.array([[1e-3 * value, 0.0, 0.12]]), k * STEP_NS)
        if watch.warning:
            assert "PSM1" in watch.warning and "along x" in watch.warning
            return k + 1
    return None


def triangle(amplitude: float, rows: int, count: int = 80) -> np.ndarray:
    """To and fro [mm], so many rows each way."""
    phase = np.arange(count) % (2 * rows)
    return amplitude * np.minimum(phase, 2 * rows - phase) / rows


@pytest.mark.parametrize(
    "x", [triangle(4, 1), triangle(10, 4), triangle(70, 12), triangle(4, 2) - 2]
)
def test_a_swing_is_named_within_two_seconds(x: np.ndarray) -> None:
    """Three turns of at least 2 mm: at the latest after 4 × 12 rows of 50 ms."""
    found = rows_until_named(x)
    assert found is not None and found * STEP_NS <= 2.5 * SECOND_NS


def test_an_overshooting_stream_is_named() -> None:
    """As measured where steps of 2 mm were counted from a set-point that runs ahead."""
    t = np.arange(80) * STEP_NS / SECOND_NS
    assert rows_until_named(35 * np.sin(2 * np.pi * t / 1.2)) is not None


@pytest.mark.parametrize(
    "x",
    [
        np.linspace(0, 100, 80),
        triangle(1.5, 1),  # below the size of a turn
        np.repeat(triangle(20, 1, 16), 6),  # it rests for 0.3 s at each turn
        5 * np.cos(2 * np.pi * np.arange(200) / 100),  # the circle of `scripted`, 5 s a turn
        np.concatenate([triangle(30, 10, 21), np.zeros(50)]),  # there and back
    ],
)
def test_a_motion_on_purpose_is_not(x: np.ndarray) -> None:
    assert rows_until_named(x) is None


def test_each_episode_begins_anew() -> None:
    watch = SwingWatch(["PSM1", "PSM2"])
    for k, value in enumerate(triangle(10, 2)):
        watch.take(np.array([[0, 0, 0.1], [0, 1e-3 * value, 0.1]]), k * STEP_NS)
    assert "PSM2" in watch.warning and "along y" in watch.warning
    watch.start()
    assert watch.warning == ""


# --- over everything that is bundled --------------------------------------------------------------

Rows = Iterator[tuple[Sequence[str], np.ndarray]]
"""Commanded arms and rows (A,) of a roll-out."""


def rows_of_an_expert(env: SurgEnv, seed: int) -> Rows:
    """Arms and commanded rows of an expert's episode, as a policy's."""
    done = False
    env.reset(seed=seed)
    while not done:
        row = env.expert_action()
        yield env.arms, row
        _, _, terminated, truncated, _ = env.step(row)
        done = terminated or truncated


def rows_of_a_policy(
    env: SurgEnv, policy: Any, seed: int
) -> Iterator[tuple[list[str], np.ndarray]]:
    """The same of a policy that needs no pictures, for 10 s."""
    seen, _ = env.reset(seed=seed)
    policy.reset("", seed)
    for step in range(200):
        state = seen["state"][: len(ARM_STATE)].astype(np.float32)
        observation = Observation({STATE_KEY: state, RCM: np.eye(4)[None]}, step, 0, 1, "", spec())
        row = np.atleast_2d(policy.act(observation))[0]
        yield env.arms, row
        seen, *_ = env.step(row)


class Swinging(hold.Hold):
    """Reverses on purpose: 4 mm to and fro, two rows each way."""

    def act(self, observation: Observation) -> np.ndarray:
        row = np.array(np.atleast_2d(super().act(observation))[0])
        row[0] += 1e-3 * triangle(4, 2, observation.step + 1)[-1]
        return row


def sharp_turns(rows: Rows) -> tuple[int, float]:
    """Most sharp turns of an axis within the window, and when a swing was named [s]; inf: never."""
    watch: SwingWatch | None = None
    most, named = 0, np.inf
    for k, (arms, row) in enumerate(rows):
        watch = watch or SwingWatch(arms)
        watch.take(row.reshape(len(arms), -1)[:, :3], k * STEP_NS)
        most = max(most, *(len(axis.turns) for axis in watch._axes.values()))
        if watch.warning:
            named = min(named, k * STEP_NS / SECOND_NS)
    return most, named


POLICIES: dict[str, Callable[[], Any]] = {
    "hold": hold.Hold,
    "scripted": scripted.Circle,
    "skeleton": skeleton.Policy,
}


def test_a_policy_that_reverses_on_purpose_is_named_in_its_roll_out(full: bool) -> None:
    env = SurgEnv("bgr")
    for seed in range(10 if full else 1):
        rows = rows_of_a_policy(env, Swinging(), 20_000 + seed)
        _, named = sharp_turns(itertools.islice(rows, 1 + 2 * SECOND_NS // STEP_NS))
        assert named <= 2.0


@pytest.mark.full
def test_no_bundled_expert_or_policy_is_called_swinging() -> None:
    """Experts of every task and the client's policies, three seeds each: 0 false alarms."""
    found: dict[str, int] = {}
    for task in names():
        env = SurgEnv(task)
        for seed in range(10_000, 10_003):
            played = {task: rows_of_an_expert(env, seed)}
            if task == "bgr":
                played |= {n: rows_of_a_policy(env, make(), seed) for n, make in POLICIES.items()}
            for name, rows in played.items():
                found[name] = max(found.get(name, 0), sharp_turns(rows)[0])
        env.close()
    print(found)
    assert max(found.values()) < TURNS, found
    most = max(found.values())
    note(13, 3 * len(found), f"at most {most} of {TURNS} sharp turns in 2 s: {', '.join(found)}")
