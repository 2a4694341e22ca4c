"""What a policy says that it sees: bounded, believed only if valid, and without any effect."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from helpers.policy import policy_messages
from helpers.policy.policy_bench import Bench
from helpers.policy.policy_server import spec
from surg_policy_bridge.nodes.policy_topics_node import plan_message
from surg_policy_client import (
    Attention,
    AttentionError,
    Keypoint,
    Observation,
    RecedingHorizon,
)
from surg_policy_client.attention import from_wire, to_wire
from surg_policy_client.conversation import Conversation
from surg_policy_client.serving import _Serving
from surg_policy_client.wire import Message, decode, encode

LEFT = "observation.images.endoscope.left"
GOOD = Attention(
    (Keypoint("tip", 0.25, 0.5, 0.9), Keypoint("target", 0.75, 0.125)),
    phase="pulling",
    confidence=0.75,
    picture=LEFT,
    heat_map=np.arange(12, dtype=np.uint8).reshape(3, 4),
    area=(0.125, 0.0, 0.875, 1.0),
)
ACT: dict[str, Any] = {"session": 1, "seq": 1, "stamp_ns": 1, "step0": 1}
CHUNK = np.zeros((2, 5), "<f4")


def raw(told: Any, *more: tuple[dict[str, Any], bytes]) -> list[bytes]:
    """Frames of an ACT with whatever is given as what the policy sees."""
    arrays = [{"key": "chunk", "dtype": "f4", "shape": [2, 5]}, *(each for each, _ in more)]
    head = policy_messages.pack(4, {**ACT, "seen": told, "arrays": arrays})
    return [head, CHUNK.tobytes(), *(data for _, data in more)]


def told(**changes: Any) -> dict[str, Any]:
    return {**to_wire(GOOD)[0], **changes}


def attention(rows: int, columns: int, dtype: str = "u1", key: str = "attention") -> Any:
    size = {"u1": 1, "f4": 4}[dtype]
    described = {"key": key, "dtype": dtype, "shape": [rows, columns]}
    return described, b"\1" * (rows * columns * size)


def test_what_is_said_arrives() -> None:
    found = decode([bytes(part) for part in encode(Message("ACT", ACT, {"chunk": CHUNK}, GOOD))])
    assert found.seen == GOOD and found.unseen == "" and list(found.arrays) == ["chunk"]
    assert found.seen.heat_map.tolist() == GOOD.heat_map.tolist()  # type: ignore[union-attr]
    nothing = decode(encode(Message("ACT", ACT, {"chunk": CHUNK})))
    assert nothing.seen is None and nothing.unseen == ""


NAN, INF = math.nan, math.inf
BAD: dict[str, list[bytes]] = {
    "no map": raw(7),
    "another version": raw(told(version=2)),
    "a key more": raw(told(plan=[])),
    "a key less": raw({"version": 1}),
    "points that are no list": raw(told(keypoints={})),
    "seventeen points": raw(told(keypoints=[["a", 0.0, 0.0, 1.0]] * 17)),
    "a point without a name": raw(told(keypoints=[["", 0.0, 0.0, 1.0]])),
    "a name of 33": raw(told(keypoints=[["x" * 33, 0.0, 0.0, 1.0]])),
    "a name that is a number": raw(told(keypoints=[[1, 0.0, 0.0, 1.0]])),
    "a point of three": raw(told(keypoints=[["a", 0.0, 0.0]])),
    "a point at NaN": raw(told(keypoints=[["a", NAN, 0.0, 1.0]])),
    "a point at infinity": raw(told(keypoints=[["a", 0.0, -INF, 1.0]])),
    "a point in pixels": raw(told(keypoints=[["a", 320.0, 240.0, 1.0]])),
    "a point that is more than certain": raw(told(keypoints=[["a", 0.0, 0.0, 1.01]])),
    "a point whose certainty is true": raw(told(keypoints=[["a", 0.0, 0.0, True]])),
    "a phase of 33": raw(told(phase="x" * 33)),
    "a phase that is none": raw(told(phase=None)),
    "a confidence of NaN": raw(told(confidence=NAN)),
    "a negative confidence": raw(told(confidence=-0.1)),
    "a picture's key that is too long": raw(told(picture="x" * 129)),
    "an area of three": raw(told(area=[0.0, 0.0, 1.0])),
    "an area without size": raw(told(area=[0.5, 0.0, 0.5, 1.0])),
    "an area outside": raw(told(area=[0.0, 0.0, 1.5, 1.0])),
    "a map of 33 rows": raw(told(), attention(33, 4)),
    "an empty map": raw(told(), attention(0, 4)),
    "a map of numbers": raw(told(), attention(3, 4, "f4")),
    "a map of another name": raw(told(), attention(3, 4, key="map")),
    "two maps": raw(told(), attention(3, 4), attention(3, 4, key="b")),
    "a map whose size lies": raw(told(), (attention(3, 4)[0], b"\1" * 11)),
    "a buffer that nobody describes": [*raw(told()), b"\1"],
    "a map that nobody sent": raw(told(), attention(3, 4))[:2],
}


@pytest.mark.parametrize("what", BAD)
def test_a_bad_one_is_dropped_and_its_actions_stay(what: str) -> None:
    found = decode(BAD[what])
    assert found.seen is None and found.unseen
    assert found.arrays["chunk"].tolist() == CHUNK.tolist() and found.head == ACT


def test_bad_actions_are_refused_however_good_the_sight() -> None:
    head = policy_messages.pack(4, {**ACT, "seen": told(), "arrays": []})
    for parts in ([head], raw(told())[:1], [raw(told())[0], b"\0" * 39]):
        with pytest.raises(ValueError):
            decode(parts)
    # Without a word about it, a second array is no part of an answer.
    arrays = [{"key": "chunk", "dtype": "f4", "shape": [2, 5]}, attention(3, 4)[0]]
    with pytest.raises(ValueError):
        decode([policy_messages.pack(4, {**ACT, "arrays": arrays}), CHUNK.tobytes(), b"\1" * 12])


@pytest.mark.parametrize(
    "change",
    [
        {"keypoints": [Keypoint("x" * 33, 0.0, 0.0)]},
        {"keypoints": [Keypoint("x", 640.0, 0.0)]},
        {"confidence": NAN},
        {"heat_map": np.zeros((40, 40), np.uint8)},
        {"heat_map": np.zeros((4, 4))},
    ],
)
def test_what_a_server_would_drop_is_named_before_it_goes_out(change: dict[str, Any]) -> None:
    with pytest.raises(AttentionError):
        to_wire(replace(GOOD, **change))


def test_numbers_of_numpy_may_be_said() -> None:
    points = [Keypoint("a", np.float32(0.5), np.float64(0.25), np.float32(1))]  # type: ignore[arg-type]
    head, _ = to_wire(Attention(points, confidence=np.float32(0.5)))  # type: ignore[arg-type]
    assert from_wire(head, None).keypoints == (Keypoint("a", 0.5, 0.25, 1.0),)


# --- the policy's side ------------------------------------------------------------------------


class FakeLink:
    """A link that keeps what is sent."""

    def __init__(self, tells: bool = True) -> None:
        self.address, self.session, self.tells = "tcp://here", 1, tells
        self.sent: list[Message] = []

    def send(self, message: Message) -> None:
        self.sent.append(message)


class Looking:
    """A policy that says what it sees."""

    def __init__(self, seen: Any) -> None:
        self._seen = seen

    def act(self, observation: Observation) -> np.ndarray:
        return np.zeros((2, 5)) + observation.step

    def seen(self) -> Any:
        return self._seen() if callable(self._seen) else self._seen


def answered(policy: Any, link: FakeLink, steps: int = 3) -> list[str]:
    """What is said while a policy answers."""
    said: list[str] = []
    serving = _Serving(policy, link, None, said.append)  # type: ignore[arg-type]
    for step in range(steps):
        serving._answer(Observation({}, step, 0, 1, "", spec(), seq=step, session=1))
    return said


def test_a_policy_that_says_what_it_sees_is_heard() -> None:
    link = FakeLink()
    assert answered(Looking(GOOD), link) == []
    assert [message.seen for message in link.sent] == [GOOD] * 3


def broken() -> Attention:
    raise RuntimeError("no eye")


@pytest.mark.parametrize("seen", [broken, replace(GOOD, confidence=7.0), "tip"])
def test_a_mistake_in_it_is_said_once_and_the_actions_go_out(seen: Any) -> None:
    link = FakeLink()
    said = answered(Looking(seen), link)
    assert len(said) == 1 and "not shown" in said[0]
    assert [m.arrays["chunk"][0, 0] for m in link.sent] == [0.0, 1.0, 2.0]
    assert all(m.seen is None for m in link.sent)


def test_an_old_server_is_told_nothing() -> None:
    link = FakeLink(tells=False)
    assert answered(Looking(GOOD), link) == [] and all(m.seen is None for m in link.sent)
    for version, tells in ((1, False), (2, True)):
        talk = Conversation(
            "tcp://here", {"client": "", "software": "", "policy": "", "wants": None}
        )
        assert talk.tick(0.0)[0].head["versions"] == [1, 2] and not talk.tells
        head = {"version": version, "session": 7, "spec": spec().to_map()}
        head.update(max_obs_age_s=0.6, ping_s=0.05, silence_s=0.15)
        talk.take(Message("WELCOME", head), 0.0)
        assert talk.tells is tells


def test_a_policy_that_is_asked_seldom_says_only_what_is_new() -> None:
    horizon = RecedingHorizon(Looking(GOOD), every=3)
    link = FakeLink()
    answered(horizon, link, steps=5)
    assert [m.seen is not None for m in link.sent] == [True, False, False, True, False]
    assert RecedingHorizon(lambda: None, every=3).seen() is None


# --- the server's side ------------------------------------------------------------------------


@pytest.fixture
def bench() -> Bench:
    made = Bench()
    made.start()
    return made


def test_the_server_knows_the_plan_and_what_was_seen(bench: Bench) -> None:
    bench.ping()
    bench.tick()
    bench.observe()
    rows = np.array([bench.here(1e-3 * i) for i in range(1, 6)])
    bench.act(rows, seen=GOOD)
    plan = bench.server.take_plan()
    assert plan is not None and plan.seen == GOOD and plan.unseen == ""
    assert (plan.session, plan.seq, plan.stamp_ns) == (bench.session, 1, bench.now)
    assert plan.first == bench.step + 1
    np.testing.assert_allclose(plan.rows, rows)
    message = plan_message(bench.server, plan)
    assert message.names == [f"PSM1/{name}" for name in ("x", "y", "z", "roll", "jaw")]
    assert (message.step, message.period, message.rows) == (plan.first, 0.05, 5)
    np.testing.assert_array_equal(message.values, rows.ravel())
    assert (message.rejected, message.rule, message.phase) == (0, "", "pulling")
    assert (message.picture, message.confidence, message.area) == (LEFT, 0.75, list(GOOD.area))
    points = zip(message.keypoints, message.x, message.y, message.certainty, strict=True)
    assert tuple(Keypoint(*point) for point in points) == GOOD.keypoints
    assert (message.map_rows, message.map_columns) == (3, 4)
    assert message.attention == bytes(range(12))
    assert bench.server.take_plan() is None, "once for each answer"


def test_the_plan_is_in_absolute_targets_and_bounded(bench: Bench) -> None:
    bench.ping()
    bench.tick()
    bench.observe()
    bench.act(np.array([bench.here(1e-4 * i) for i in range(1, 101)]))
    plan = bench.server.take_plan()
    assert plan is not None and plan.rows.shape == (32, 5) and plan.seen is None


def test_a_refused_chunk_is_no_plan(bench: Bench) -> None:
    bench.ping()
    bench.tick()
    bench.observe()
    bench.act(np.zeros((3, 4)), seen=GOOD)
    assert bench.server.take_plan() is None
    newest = bench.server.steps.last_rejected
    assert newest is not None and newest.rule == "shape" and newest.text


def test_what_is_invalid_is_counted_and_stops_and_moves_nothing() -> None:
    ends = []
    for spoil in (None, [], [["tip", 320.0, 240.0, 1.0]]):
        bench = Bench()
        bench.start()
        for n in range(20):
            bench.ping()
            bench.tick()
            bench.observe()
            head = {**bench.of("OBS")[-1].head}
            act = {"session": bench.session, "seq": head["seq"], "stamp_ns": head["stamp_ns"]}
            act["step0"] = head["step"] + 1
            arrays = [{"key": "chunk", "dtype": "f8", "shape": [1, 5]}]
            if spoil is not None:
                act["seen"] = told(keypoints=spoil)
            parts = [policy_messages.pack(4, {**act, "arrays": arrays})]
            parts.append(bench.here(1e-3).astype("<f8").tobytes())
            bench.endpoint.receive(b"a", parts, bench.now)
            bench._hear()
            plan = bench.server.take_plan()
            assert plan is not None and bool(plan.unseen) is bool(spoil), n
            bench.execute()
            bench.now += 50_000_000
            bench.step += 1
        assert bench.server.state.value == "RUNNING" and bench.errors == []
        assert bench.server.counters.malformed["seen"] == (20 if spoil else 0)
        assert bench.server.counters.accepted == 20
        ends.append(bench.arm.view.p_BSet.tobytes())
    assert len(set(ends)) == 1


def test_answers_of_both_versions_are_understood(bench: Bench) -> None:
    for versions, agreed in (([1, 1], 1), ([1, 2], 2), ([1, 9], 2)):
        other = Bench()
        other.hello(versions=versions)
        assert other.of("WELCOME")[-1].head["version"] == agreed
