"""Status of all pages, 20 times per second: JSON in SI units, with messages for the operator."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from surg_console.session import operator_messages
from surg_console.session.console_session import ConsoleSession, Phase
from surg_console.session.system_state import Arm, Robot

STALE = 1.0
"""[s] Timeout of an arm's state."""
RECENT = 6.0
"""[s] Display time of a warning."""

_HEADLINES = {
    Phase.FREE: "No one has control",
    Phase.READY: "Ready",
    Phase.STARTING: "Enabling the arm",
    Phase.HELD: "Held",
}


def report(
    session: ConsoleSession, robot: Robot, limits: Mapping[str, float], now: float
) -> dict[str, Any]:
    """Content of the status, with the limits of the driven arm by name [SI]."""
    return {
        "say": "status",
        "phase": session.phase.value,
        "headline": _headline(session, robot),
        "sentence": operator_messages.as_sentence(sentence(session, robot, now)),
        "holder": session.holder,
        "pages": session.pages,
        "arms": [_arm(arm, now) for arm in robot.arms],
        # An arm without a controller has no line of its own.
        "helpers": [
            {"name": f"{hand.arm} ({hand.leader})", "state": hand.state, "sentence": hand.reason}
            for hand in robot.helpers
        ],
        "gauges": {name: finite(value) for name, value in vars(robot.gauges).items()},
        "drift": None if robot.drift is None else vars(robot.drift),
        "fixtures": None if robot.fixtures is None else robot.fixtures.as_json(),
        "limits": dict(limits),
        "scale": finite(robot.follower.scale),
        "teleop": robot.follower.state,
        "wall": (robot.scope if session.scoping else robot.follower).at_wall,
        "record": {
            "on": robot.recorder.recording,
            "finishing": robot.recorder.state == "FINISHING",
            "problem": robot.recorder.problem,
            "finished": Path(robot.recorder.finished).name,
        },
        "faulted_arms": list(robot.faulted_arms),
        "policy": {
            "state": robot.policy.state,
            "on": robot.policy.active,
            "sentence": operator_messages.as_sentence(operator_messages.policy_sentence(robot)),
        },
    }


def sentence(session: ConsoleSession, robot: Robot, now: float) -> str:
    """The most important message for the operator."""
    arm = robot.arms[0] if robot.arms else None
    if session.phase is Phase.DRIVING:
        if session.scoping:
            return robot.scope.reason or operator_messages.driving_endoscope(
                robot.scope.arm, session.clutched
            )
        if robot.follower.reason:
            return robot.follower.reason
        if session.clutched:
            return "The clutch is held. The tip stays."
        if arm is not None and now - arm.warned < RECENT:
            return arm.warning
        return "The tip follows your hand."
    policy = robot.policy.active or session.reason == operator_messages.POLICY_ASKED
    text = operator_messages.policy_sentence(robot)
    if session.phase is Phase.READY and policy and text:
        return text
    if session.reason:
        return session.reason
    if arm is None or not arm.state:
        return operator_messages.NO_ARM
    if session.phase is Phase.STARTING:
        return f"{arm.name} is {arm.state} and is being homed and enabled."
    text = f"{arm.name}: {operator_messages.state_sentence(arm)}"
    return f"{text}. Press Enable to begin." if session.phase is Phase.READY else text


def _headline(session: ConsoleSession, robot: Robot) -> str:
    """The state in one or two words."""
    if session.phase is Phase.READY and robot.policy.state == "RUNNING":
        return "Policy"
    if any(arm.state == "FAULT" for arm in robot.arms):
        return "Fault"
    if session.phase is not Phase.DRIVING:
        return _HEADLINES[session.phase]
    if session.clutched or (session.scoping and not robot.scope.state):
        return "Clutched"
    hand, headline = robot.follower, "Following"
    if session.scoping:
        hand, headline = robot.scope, "Endoscope"
    return headline if hand.state == "FOLLOWING" else "Waiting"


def _arm(arm: Arm, now: float) -> dict[str, Any]:
    silent = now - arm.heard > STALE
    return {
        "name": arm.name,
        "state": "SILENT" if silent else arm.state,
        "homed": arm.homed,
        "sentence": "silent; check that its controller runs (./surg status)"
        if silent
        else operator_messages.state_sentence(arm),
    }


def finite(value: object) -> float | None:
    """The number if it is finite, else None, because JSON has no NaN."""
    try:
        number = float(value) if isinstance(value, int | float) else math.nan
    except OverflowError:
        return None
    return number if math.isfinite(number) else None
