"""The status message of the model server carries every counter under its own name."""

import dataclasses
from collections import Counter
from types import SimpleNamespace

from surg_core.status_check import fault
from surg_policy_bridge.nodes.policy_status_node import policy_status
from surg_policy_bridge.server.counters import Counters
from surg_policy_bridge.server.model_server import State
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
        state=State.PAUSED,
        cause=StopReason.OPERATOR,
        reason="the operator wants PSM1",
        waiting=False,
        episode=2,
        steps=SimpleNamespace(queue=[]),
    )
    message = policy_status(server, "refused", "tcp://127.0.0.1:5555")  # type: ignore[arg-type]
    assert fault(message) == ""
    assert (message.state, message.reason) == (message.STATE_PAUSED, message.REASON_OPERATOR)
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
