"""The messages of the model server: every counter, newest refusal, nothing that only grows."""

import dataclasses
import io
from collections import Counter
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from helpers.policy.policy_bench import MS, Bench
from surg_core.status_check import fault
from surg_policy_bridge.nodes import lock_step_node, policy_topics_node
from surg_policy_bridge.nodes.lock_step_node import LockStep
from surg_policy_bridge.nodes.policy_status_node import policy_status
from surg_policy_bridge.nodes.policy_topics_node import PolicyTopics, plan_message
from surg_policy_bridge.server.counters import Counters
from surg_policy_bridge.server.model_server import ServerState
from surg_policy_bridge.server.policy_plan import PolicyPlan
from surg_policy_bridge.server.step_executor import KEPT
from surg_policy_bridge.server.stop_reason import StopReason


def test_every_counter_is_published() -> None:
    counters = Counters()
    plain = [each.name for each in dataclasses.fields(counters) if each.type == "int"]
    for number, name in enumerate(plain, start=1):
        setattr(counters, name, number)
    counters.rejected = Counter(step=3, start=4)
    counters.malformed = Counter(size=5)
    server = SimpleNamespace(
        session=None,
        counters=counters,
        state=ServerState.PAUSED,
        cause=StopReason.OPERATOR,
        reason="the operator wants PSM1",
        waiting=False,
        episode=2,
        steps=SimpleNamespace(queue=[], swings=SimpleNamespace(warning="it swings")),
    )
    message = policy_status(server, "refused", "tcp://127.0.0.1:5555")  # type: ignore[arg-type]
    assert fault(message) == ""
    assert (message.state, message.reason) == (message.STATE_PAUSED, message.REASON_OPERATOR)
    assert message.warning == "it swings"
    assert len(plain) >= 8
    assert [getattr(message, name) for name in plain] == list(range(1, len(plain) + 1))
    assert dict(zip(message.rejected_rules, message.rejected_by_rule, strict=True)) == {
        "start": 4,
        "step": 3,
    }
    assert (message.rejected, message.malformed_codes, list(message.malformed)) == (
        7,
        ["size"],
        [5],
    )


def test_counters_beyond_32_bits_end_no_server() -> None:
    """Somebody who floods the port fills 32 bits within a day."""
    bench, most = Bench(), 2**32 - 1
    for each in dataclasses.fields(Counters):
        if each.type == "int":
            setattr(bench.server.counters, each.name, most + 1)
    bench.server.counters.rejected = Counter(step=most, start=7)
    bench.server.counters.malformed = Counter(size=2**40)
    status = policy_status(bench.server, "", "")
    plan = plan_message(bench.server, PolicyPlan(1, 1, 1, 1, np.zeros((1, 5))))
    for message in (status, plan):
        message.serialize(io.BytesIO())
        assert message.rejected == message.accepted == message.stale == most
    assert (status.rejected_by_rule, status.malformed) == ([7, most], [most])
    assert plan.rows == 1


def test_the_newest_refusal_is_of_this_episode() -> None:
    bench = Bench()
    bench.start()
    bench.period([bench.here(0.05)])
    plan = PolicyPlan(1, 1, 1, 1, np.zeros((1, 5)))

    def shown() -> str:
        return str(plan_message(bench.server, plan).rule)

    def start() -> None:
        assert bench.server.enable(True, bench.now) == ""
        for _ in range(4):
            bench.tick()
        assert bench.server.state is ServerState.RUNNING

    assert shown() == "start"
    bench.server.enable(False, bench.now)
    start()
    assert shown() == "start", "a pause is no end"
    bench.server.episode_over(True, "done")
    assert shown() == "start", "a page still shows the episode"
    start()
    assert bench.server.episode == 2 and shown() == ""


def test_refusals_do_not_pile_up_while_no_tick_comes(monkeypatch: pytest.MonkeyPatch) -> None:
    """A simulator that has ended or waits; the policy goes on answering what was never asked."""
    published: list[Any] = []
    monkeypatch.setattr(
        policy_topics_node.rospy,
        "Publisher",
        lambda *_, **__: SimpleNamespace(publish=published.append),
    )
    monkeypatch.setattr(lock_step_node, "Participant", lambda *_, **__: SimpleNamespace(tick=25))
    bench = Bench()
    bench.hello()
    settings = SimpleNamespace(arms=["PSM1"], task="")
    topics = PolicyTopics("")
    node = SimpleNamespace(
        server=bench.server, settings=settings, topics=topics, ports={}, lock=None
    )
    loop = LockStep(node)  # type: ignore[arg-type]
    act = {"session": bench.session, "seq": 5, "stamp_ns": 5, "step0": 1}
    for _ in range(100):
        bench.now += 10 * MS
        bench.say("ACT", arrays={"chunk": np.zeros((1, 5))}, **act)
        loop.turn()
        assert not bench.server.steps.judged
    assert len(published) == 100 and published[-1].rule == "observation"
    assert published[-1].header.stamp.to_nsec() == 26 * 2 * MS


def test_targets_are_forgotten_also_where_steps_are_missing() -> None:
    bench = Bench()
    bench.start()
    pattern = np.random.default_rng(3).integers(0, 2, 300)
    for number, skip in enumerate(pattern):
        bench.period([bench.here()])
        if skip and number % 2:
            bench.period()
    assert bench.server.counters.empty > 30
    assert len(bench.server.steps._sent) <= KEPT
