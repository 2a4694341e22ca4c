"""The model server's state as a surg_msgs/PolicyStatus."""

from __future__ import annotations

import time
from typing import Any

import rospy

from surg_core.contract import SECOND_NS, STEP
from surg_msgs.msg import PolicyStatus
from surg_policy_bridge.server.model_server import ModelServer

COUNTS = (
    *("accepted", "clipped", "late", "stale", "empty", "waited", "messages"),
    *("flooded", "strangers", "sessions"),
)
"""Fields that counters and message have in common."""
MOST = 2**32 - 1
"""Largest number of a field of type uint32."""


def saturate(message: Any) -> None:
    """Limit a message's fields of type uint32 and uint32[] to what they can hold.

    Its counters run as long as the node, and a peer that floods the port fills 32 bits in hours; a
    number beyond them cannot be sent.
    """
    for name, kind in zip(message.__slots__, message._slot_types, strict=True):
        if kind == "uint32":
            setattr(message, name, min(getattr(message, name), MOST))
        elif kind == "uint32[]":
            setattr(message, name, [min(count, MOST) for count in getattr(message, name)])


def policy_status(server: ModelServer, refused: str, address: str) -> PolicyStatus:
    """What the server at an address does now; ``refused``: why the last enable was."""
    session, counters = server.session, server.counters
    rejected, malformed = sorted(counters.rejected.items()), sorted(counters.malformed.items())
    message = PolicyStatus(
        version=PolicyStatus.VERSION,
        state=getattr(PolicyStatus, f"STATE_{server.state.name}"),
        reason=getattr(PolicyStatus, f"REASON_{server.cause.name}"),
        detail=server.reason,
        refused=refused,
        warning=server.steps.swings.warning,
        waiting=server.waiting,
        session=session.number if session else 0,
        client=session.client if session else "",
        policy=session.policy if session else "",
        address=address,
        episode=server.episode,
        queue=len(server.steps.queue),
        period=STEP,
        rejected=counters.rejected.total(),
        rejected_rules=[rule for rule, _ in rejected],
        rejected_by_rule=[count for _, count in rejected],
        malformed_codes=[code for code, _ in malformed],
        malformed=[count for _, count in malformed],
        **{name: getattr(counters, name) for name in COUNTS},
    )
    message.obs_age_p50, message.obs_age_p99 = counters.obs_age.percentiles
    message.round_trip_p50, message.round_trip_p99 = counters.round_trip.percentiles
    message.header.stamp = rospy.Time(*divmod(time.time_ns(), SECOND_NS))
    saturate(message)
    return message
