"""An arm by name: what LeRobot's robots see and send, against a server of the test."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import numpy as np
import pytest

from helpers.policy.policy_server import PolicyServer, spec
from surg_policy_client import BadAction, Feature, Refused, RemoteEnv, Spec, SpecMismatch
from surg_policy_client.adapters.by_name import ArmByName
from surg_policy_client.wire import Message

HOLD = {f"PSM1/{name}.pos": float(i) for i, name in enumerate(("x", "y", "z", "roll", "jaw"))}


@pytest.fixture
def server() -> Iterator[PolicyServer]:
    with PolicyServer(spec(pictures=True)) as server:
        yield server


@pytest.fixture
def arm(server: PolicyServer) -> Iterator[ArmByName]:
    with RemoteEnv(server.address, timeout_s=5.0) as env:
        yield ArmByName(env)


def begin(server: PolicyServer, arm: ArmByName, step: int = 1) -> None:
    """An episode begins, and the arm has seen two of its observations."""
    server.wait("PING")
    server.observe(step - 1)
    arm.begin()
    server.observe(step)
    arm.observe()


def test_features_are_known_before_anything_was_observed(arm: ArmByName) -> None:
    """Names end in .pos: lerobot 0.6.1 passes only these from a robot to a policy."""
    state = ("tip_x", "tip_y", "tip_z", "roll", "jaw", "set_x", "set_y", "set_z", "roll_set")
    seen = arm.observation_features
    assert list(seen)[:9] == [f"PSM1/{name}.pos" for name in state]
    assert seen["endoscope.left"] == (480, 640, 3) and len(seen) == 11
    assert arm.action_features == dict.fromkeys(HOLD, float)


def test_numbers_and_pictures_come_by_name(server: PolicyServer, arm: ArmByName) -> None:
    server.wait("PING")
    server.observe(6)
    arm.begin()
    server.observe(7)
    seen = arm.observe()
    assert set(seen) == set(arm.observation_features)
    assert seen["PSM1/set_z.pos"] == 7.0 and isinstance(seen["PSM1/set_z.pos"], float)
    assert seen["endoscope.right"].shape == (480, 640, 3) and seen["endoscope.right"].max() == 7


def test_an_action_is_sent_in_the_servers_order_and_held_for_a_second_row(
    server: PolicyServer, arm: ArmByName
) -> None:
    begin(server, arm, 4)
    arm.send(dict(reversed(HOLD.items())))
    act = server.wait("ACT")
    assert act.head["step0"] == 5
    np.testing.assert_array_equal(act.arrays["chunk"], [[0, 1, 2, 3, 4]] * 2)


@pytest.mark.parametrize(
    ("strange", "said"),
    [
        ({"PSM1/tip_x.pos": 0.0}, "PSM1/tip_x.pos.*exactly PSM1/x.pos"),
        ({}, "nothing.*exactly"),
        ({**HOLD, "PSM1/x.pos": float("nan")}, "PSM1/x is nan"),
    ],
    ids=["a robot's position", "empty", "no number"],
)
def test_an_action_that_is_none_is_refused_and_not_sent(
    server: PolicyServer, arm: ArmByName, strange: dict[str, float], said: str
) -> None:
    """lerobot-rollout sends observed positions when it wants to go back: they are no action."""
    begin(server, arm)
    with pytest.raises(BadAction, match=said):
        arm.send(strange)
    arm.send(HOLD)
    server.wait("ACT")
    assert [m.kind for _, m in server.heard].count("ACT") == 1


def test_a_hand_moves_on_from_where_the_arm_is_told_to_be(
    server: PolicyServer, arm: ArmByName
) -> None:
    with pytest.raises(RuntimeError, match="connect first"):
        arm.nudged({}, 1.0, 1.0, "PSM1")
    begin(server, arm, 3)
    hand = {"delta_x": 0.5, "delta_y": 0.0, "delta_z": -1.0, "gripper": 2}
    moved = arm.nudged(hand, 0.002, 0.1, "PSM1")
    assert list(moved.values()) == pytest.approx([3.001, 3.0, 2.998, 3.0, 3.1])
    del hand["gripper"]
    assert arm.nudged(hand, 0.002, 0.1, "PSM1")["PSM1/jaw.pos"] == 3.0
    with pytest.raises(SpecMismatch, match=r"no arm PSM2.*PSM1/x"):
        arm.nudged(hand, 0.002, 0.1, "PSM2")


def test_pictures_are_scaled_as_an_export_scales_them(server: PolicyServer) -> None:
    with RemoteEnv(server.address, timeout_s=5.0) as env:
        arm = ArmByName(env, 160)
        assert arm.pictures == dict.fromkeys(("endoscope.left", "endoscope.right"), (120, 160, 3))
        server.wait("PING")
        server.observe(8)
        arm.begin()
        server.observe(9)
        assert arm.observe()["endoscope.left"].shape == (120, 160, 3)


def test_a_refused_step_is_told_once(server: PolicyServer, arm: ArmByName) -> None:
    begin(server, arm)
    refused = {"step": 2, "rule": "start", "text": "3.1 mm away; allowed: 2 mm"}
    counts = dict.fromkeys(("accepted", "clipped", "late", "stale", "queue"), 0)
    ack = {"session": server.session, "seq": 1, **counts, "rejected": [refused]}
    server.say(Message("ACK", ack))
    server.observe(2)
    arm.observe()
    assert arm.refused == [refused]
    server.observe(3)
    arm.observe()
    assert arm.refused == []


def test_the_end_of_an_episode_is_said_and_no_observation(
    server: PolicyServer, arm: ArmByName
) -> None:
    begin(server, arm)
    arm.send(HOLD)
    threading.Timer(0.1, lambda: server.episode(0, "end", True)).start()
    with pytest.raises(Refused, match="the episode is over: as the test says"):
        arm.observe()


def test_an_episode_in_which_nothing_was_sent_may_begin_again(
    server: PolicyServer, arm: ArmByName
) -> None:
    """As when a policy is enabled again that was late with its first step."""
    begin(server, arm)
    server.episode(0, "end", False)
    for step in (0, 1):
        threading.Timer(0.2 + 0.2 * step, server.observe, (step, 1)).start()
    assert arm.observe()["PSM1/set_z.pos"] == 1.0
    arm.send(HOLD)
    threading.Timer(0.1, server.episode, (1, "end", False)).start()
    with pytest.raises(Refused, match="the episode is over"):
        arm.observe()


def test_a_server_without_names_is_no_arm() -> None:
    full = spec()
    bare = {"observation.state": Feature(dtype="f4", shape=(9,))}
    served = Spec("bgr", 0.05, bare, full.action)
    with (
        PolicyServer(served) as server,
        RemoteEnv(server.address, timeout_s=5.0) as env,
        pytest.raises(SpecMismatch, match=r"names no numbers of observation\.state"),
    ):
        ArmByName(env)
