"""May a policy have the arms? The operator comes first. Values in, values out.

The answer is yes only where the teleoperation states, in a valid and fresh message, that no hand
wants one of them. In a system without teleoperation nobody has to state it; but a teleoperation
node that has spoken once must go on.
"""

from __future__ import annotations

from collections.abc import Collection

from surg_core.status_check import LatestStatus
from surg_policy_bridge.server.stop_reason import StopReason

Refusal = tuple[StopReason, str]
"""The reason, and the same in words."""
MAY = (StopReason.NONE, "")
"""The policy may have the arms."""


def refusal(
    arms: Collection[str],
    teleop: LatestStatus,
    now: float,
    need_teleop: bool = True,
    present: bool = True,
    moved: str = "",
) -> Refusal:
    """Why the policy may not have the arms that it commands, or `MAY`.

    Args:
        arms: Names of the arms.
        teleop: The newest surg_msgs/TeleopStatus.
        now: The receiver's steady clock [s].
        need_teleop: Whether the system has a teleoperation node.
        present: Whether somebody is at the controls, or nobody has to be.
        moved: Why the pictures that a policy is served are not what was calibrated.
    """
    if need_teleop or teleop.heard:
        status = teleop.at(now)
        if status is None:
            return StopReason.TELEOP_STATUS, teleop.problem(now)
        if not status.hands or not all(hand.arm and hand.leader for hand in status.hands):
            return StopReason.TELEOP_STATUS, "the teleoperation's status names no hand or no arm"
        for hand in status.hands:
            if hand.arm in arms and hand.state != hand.STATE_DISABLED:
                return StopReason.OPERATOR, f"the operator wants {hand.arm} ({hand.leader})"
    if not present:
        return StopReason.NOT_PRESENT, "nobody is at the controls (operator_present)"
    if moved:
        return StopReason.CAMERA_MOVED, moved
    return MAY
