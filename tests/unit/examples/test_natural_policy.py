"""A first policy, counting its steps from held_action(): in Gymnasium and over the wire.

Steps of 2 mm, 20 times a second, command 40 mm/s; the skeleton's steps of 0.5 mm 10 mm/s.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any, Protocol

import numpy as np
import pytest

from helpers.policy.led_arm import LedBench
from helpers.policy.policy_bench import ARM, HOME, spec
from helpers.results.policy_results import note
from surg_core.contract import ARM_STATE, STATE_KEY, TICK
from surg_policy_client import Observation, RemoteEnv
from surg_policy_client.observation import RCM
from surg_policy_client.policies import skeleton
from surg_sim.tasks.scripted_sender import home_frame

STEPS = 40
"""Grid times of a roll-out: 2 s."""
WINDOW = 5
"""Ticks over which the speed is taken."""


class Policy(Protocol):
    goal: np.ndarray | None

    def reset(self, instruction: str, seed: int) -> None: ...
    def act(self, observation: Observation) -> np.ndarray: ...


class Natural:
    """As a newcomer writes it: at most 2 mm a row, to a goal 10 mm away in the rcm frame."""

    def __init__(self, seed: int) -> None:
        way = np.random.default_rng(seed).normal(size=3)
        self._way = 0.01 * way / np.linalg.norm(way)

    def reset(self, instruction: str, seed: int) -> None:
        self.goal: np.ndarray | None = None

    def act(self, observation: Observation) -> np.ndarray:
        row = observation.held_action()
        if self.goal is None:
            self.goal = row[:3] + self._way
        way = self.goal - row[:3]
        row[:3] += way * min(1.0, 0.002 / max(float(np.linalg.norm(way)), 1e-9))
        return row


def in_gymnasium(policy: Policy, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The tip of each tick (N, 3) and X_WR (4, 4)."""
    from surg_sim.envs.surg_env import SurgEnv

    env = SurgEnv("bgr")
    session, tips = env.session, []
    tick = session.tick

    def watched(*arguments: Any) -> Any:
        done = tick(*arguments)
        tips.append(env._spaces._view(ARM, done).p_tip)
        return done

    session.tick = watched  # type: ignore[method-assign]
    seen, _ = env.reset(seed=20_000 + seed)
    X_WR = home_frame(session.cell.arms[ARM])
    tips.clear()
    for step in range(STEPS):
        state = seen["state"][[env.state_names.index(f"{ARM}/{name}") for name in ARM_STATE]]
        arrays = {STATE_KEY: state.astype(np.float32), RCM: X_WR[None]}
        row = policy.act(Observation(arrays, step, 0, 1, "", spec()))
        seen, _, _, _, info = env.step(row)
        assert info["refused"] == 0, info
    env.close()
    return np.array(tips), X_WR


def over_the_wire(policy: Policy, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The same through the client, ZeroMQ, the model server and the controller."""
    with LedBench() as server, RemoteEnv(server.address, timeout_s=60.0) as env:

        def begin() -> None:
            refused = "not asked yet"
            while refused:  # until the client has connected
                time.sleep(0.02)
                with server.lock:
                    refused = server.server.enable(True, server.now)

        threading.Thread(target=begin, daemon=True).start()
        observation, _ = env.reset()
        for _ in range(STEPS):
            observation, _, terminated, _, info = env.step(policy.act(observation))
            assert not terminated, info
        assert not server.server.counters.rejected
        return np.array(server.arm.tips), np.eye(4)


def measured(tips: np.ndarray, goal: np.ndarray) -> tuple[float, float, float]:
    """How far the tip passes its goal, how far from it it ends [mm], its speed [mm/s]."""
    way = (goal - tips[0]) / np.linalg.norm(goal - tips[0])
    speed = np.linalg.norm(tips[WINDOW:] - tips[:-WINDOW], axis=1).max() / (WINDOW * TICK)
    beyond, left = float(((tips - goal) @ way).max()), float(np.linalg.norm(tips[-1] - goal))
    return 1e3 * max(beyond, 0.0), 1e3 * left, 1e3 * float(speed)


WAYS: dict[str, Callable[[Policy, int], tuple[np.ndarray, np.ndarray]]] = {
    "Gymnasium": in_gymnasium,
    "wire": over_the_wire,
}


@pytest.fixture(scope="module")
def found() -> Iterator[dict[str, dict[str, list[tuple[float, float, float]]]]]:
    """What was measured, by policy and way; noted at the end, once both ways are known."""
    kept: dict[str, dict[str, list[tuple[float, float, float]]]] = {"natural": {}, "skeleton": {}}
    yield kept
    for row, ways in zip((11, 12), kept.values(), strict=True):
        worst = {way: np.max(cases, axis=0) for way, cases in ways.items()}
        words = (f"{way} {w[0]:.1f} mm, {w[2]:.0f} mm/s" for way, w in worst.items())
        if len(ways) == len(WAYS):
            note(row, sum(map(len, ways.values())), "; ".join(words))


@pytest.mark.parametrize("way", WAYS)
def test_steps_of_2_mm_from_the_held_action_arrive(way: str, found: Any, full: bool) -> None:
    """None is refused, also the first one, which is as long as allowed; none swings."""
    for seed in range(10 if full else 2):
        policy = Natural(seed)
        policy.reset("", seed)
        tips, _ = WAYS[way](policy, seed)
        assert policy.goal is not None
        beyond, left, speed = measured(tips, policy.goal)
        assert beyond < 1.0 and left < 0.1 and speed < 70.0, (beyond, left, speed)
        found["natural"].setdefault(way, []).append((beyond, left, speed))


@pytest.mark.parametrize("way", WAYS)
def test_the_skeleton_reaches_its_place_in_the_world(way: str, found: Any, full: bool) -> None:
    """10 mm up in the world, to 1 mm; at most 2 mm beyond it and 25 mm/s."""
    for seed in range(10 if full else 1):
        policy = skeleton.Policy()
        policy.reset("", seed)
        tips, X_WR = WAYS[way](policy, seed)
        assert policy.goal is not None
        goal = X_WR[:3, :3].T @ (policy.goal - X_WR[:3, 3])
        np.testing.assert_allclose(goal - HOME, X_WR[2, :3] * 0.01, atol=1e-4)
        beyond, left, speed = measured(tips, goal)
        assert beyond <= 2.0 and left <= 1.0 and speed <= 25.0, (beyond, left, speed)
        found["skeleton"].setdefault(way, []).append((beyond, left, speed))
