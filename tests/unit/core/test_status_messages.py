"""Status messages: what is not valid, known and fresh never gives an arm away.

`test_status_fields.py` removes every field of every status.
"""

from __future__ import annotations

import math
from copy import deepcopy
from typing import Any

import pytest

pytest.importorskip("rospy")

import surg_core
from helpers.graph.statuses import (
    complete,
    fields,
    newest,
    teleop_status,
)
from surg_core.status_check import SILENCE, LatestStatus, fault, value_name, values
from surg_msgs import msg
from surg_policy_bridge.server import operator_first
from surg_policy_bridge.server.model_server import ServerState
from surg_policy_bridge.server.stop_reason import StopReason

NOW = 100.0


def given(message: Any, now: float = NOW, received: float = NOW) -> bool:
    """Whether the policy gets PSM1 by this message."""
    return (
        operator_first.refusal(["PSM1"], newest("/teleop/status", message, received), now)
        == operator_first.MAY
    )


def test_a_valid_fresh_disabled_hand_gives_the_arm_away() -> None:
    assert given(teleop_status("DISABLED"))
    assert given(teleop_status("DISABLED"), NOW + SILENCE)
    assert given(teleop_status("FOLLOWING", arm="PSM2")), "another arm is not the policy's"


@pytest.mark.parametrize("state", ["WAITING", "FOLLOWING", "CLUTCHED", "FAULT"])
def test_the_operator_comes_first(state: str) -> None:
    refused = operator_first.refusal(
        ["PSM1"], newest("/teleop/status", teleop_status(state), NOW), NOW
    )
    assert refused[0] is StopReason.OPERATOR


@pytest.mark.parametrize("path", ["version", "hands.state", "hands.mapping"])
@pytest.mark.parametrize("value", [0, 77, 255])
def test_no_unknown_value_gives_the_arm_away(path: str, value: int) -> None:
    message = teleop_status()
    part = message.hands[0] if "." in path else message
    setattr(part, path.rpartition(".")[2], value)
    refused = operator_first.refusal(["PSM1"], newest("/teleop/status", message, NOW), NOW)
    assert refused[0] is StopReason.TELEOP_STATUS
    assert "/teleop/status" in refused[1] and path.rpartition(".")[2] in refused[1]


def test_no_message_and_an_old_one_give_nothing_away() -> None:
    assert not given(None)
    assert not given(teleop_status(), NOW + SILENCE + 1e-6)
    assert not given(teleop_status(), NOW - 1e-6), "received in the future: no steady clock"
    assert not given(teleop_status(), math.nan)


def test_a_system_without_teleoperation_needs_no_status_until_one_has_spoken() -> None:
    def refused(message: Any, now: float = NOW) -> StopReason:
        return operator_first.refusal(
            ["PSM1"], newest("/teleop/status", message, NOW), now, need_teleop=False
        )[0]

    assert refused(None) is StopReason.NONE
    assert refused(teleop_status()) is StopReason.NONE
    assert refused(teleop_status(), NOW + SILENCE + 1.0) is StopReason.TELEOP_STATUS
    assert refused(msg.TeleopStatus()) is StopReason.TELEOP_STATUS


def test_nobody_present_gives_nothing_away() -> None:
    refused = operator_first.refusal(
        ["PSM1"], newest("/teleop/status", teleop_status(), NOW), NOW, present=False
    )
    assert refused[0] is StopReason.NOT_PRESENT


@pytest.mark.parametrize(
    "kind",
    [
        "TeleopStatus",
        "PolicyStatus",
        "RecordStatus",
        "SimStatus",
        "SenderStatus",
        "CalibrationStatus",
        "DriftStatus",
    ],
)
def test_every_status_declares_version_stamp_and_enumerations_without_zero(kind: str) -> None:
    message = complete(kind)
    assert fault(message) == ""
    for path in ("version", "header.stamp"):
        wrong = deepcopy(message)
        if path == "version":
            wrong.version = 0
        else:
            wrong.header.stamp = type(wrong.header.stamp)()
        assert path in fault(wrong)
    checked = 0
    for path, part, name in fields(message):
        if known := values(part, name):
            checked += 1
            assert 0 not in known and len(known) == len(set(known.values()))
            for unknown in (0, max(known) + 1):
                wrong = deepcopy(message)
                target = next(p for at, p, n in fields(wrong) if (at, n) == (path, name))
                setattr(target, name, unknown)
                assert path in fault(wrong)
    assert checked >= 1
    assert fault(type(message)()) != "", "a default-constructed message is invalid"


def test_a_problem_is_reported_once_until_it_changes() -> None:
    found = LatestStatus("/teleop/status")
    assert found.complaint(0.0) == found.problem(0.0) != ""
    assert found.complaint(1.0) == ""
    assert found.complaint(11.0) != "", "again after a while"
    found.take(teleop_status(), 12.0)
    assert found.complaint(12.0) == found.problem(12.0) == ""
    found.take(msg.TeleopStatus(version=9), 12.5)
    assert "version is 9" in found.complaint(12.5)
    assert found.complaint(12.6) == ""
    assert "no message for" not in found.problem(12.6)


def test_the_names_of_codes_are_those_of_the_enumerations() -> None:
    reasons = {f"REASON_{name}": int(value) for name, value in surg_core.Reason.__members__.items()}
    declared = {k: getattr(msg.Cycle, k) for k in dir(msg.Cycle) if k.startswith("REASON_")}
    assert declared == reasons
    policy = msg.PolicyStatus
    assert set(values(policy, "reason").values()) == {reason.name for reason in StopReason}
    assert set(values(policy, "state").values()) == {state.name for state in ServerState}


def test_states_of_hands_and_senders_are_those_of_the_nodes() -> None:
    from surg_teleop.follow.teleop_types import TeleopState as HandState
    from surg_teleop.playback.motion_player import PlayerStage

    hand = msg.HandStatus
    assert set(values(hand, "state").values()) == {state.name for state in HandState}
    assert set(values(msg.SenderStatus, "stage").values()) == {stage.name for stage in PlayerStage}
    assert value_name(hand(state=99), "state") == ""
