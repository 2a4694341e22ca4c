"""Topics of the policy: its judged steps and its plan, whether it is enabled, and its status."""

from __future__ import annotations

import math

import rospy
from std_msgs.msg import Bool

from surg_core.contract import SECOND_NS, STEP
from surg_msgs.msg import PolicyAction, PolicyPlan, PolicyStatus
from surg_policy_bridge.nodes.policy_status_node import policy_status, saturate
from surg_policy_bridge.server import policy_plan
from surg_policy_bridge.server.model_server import ModelServer, ServerState
from surg_policy_client.attention import Attention

STATUS_PERIOD = SECOND_NS // 2
"""[ns] Longest interval between two status messages."""


class PolicyTopics:
    """Publishers of ``/policy``; ``address`` is the server's."""

    def __init__(self, address: str) -> None:
        out = rospy.Publisher
        self._address = address
        self._action = out("/policy/action", PolicyAction, queue_size=0, tcp_nodelay=True)
        self._rejected = out("/policy/rejected", PolicyAction, queue_size=0, tcp_nodelay=True)
        self._plan = out("/policy/plan", PolicyPlan, queue_size=1, tcp_nodelay=True)
        self._blind_session = 0
        self._enabled = out("/policy/enabled", Bool, queue_size=2, latch=True)
        self._status = out("/policy/status", PolicyStatus, queue_size=2, latch=True)
        self._last: tuple[object, ...] = ()
        self._last_time = -STATUS_PERIOD

    def publish_judged(self, server: ModelServer, stamp_ns: int) -> None:
        """Publish the steps judged since the last call."""
        judged, server.steps.judged = server.steps.judged, []
        for step in judged:
            message = PolicyAction(
                session=step.session,
                seq=step.seq,
                step=step.step,
                obs_age=step.obs_age / SECOND_NS,
                names=server.action_names,
                values=step.values.tolist(),
                rule=step.rule,
                text=step.text,
            )
            message.header.stamp = rospy.Time(*divmod(stamp_ns, SECOND_NS))
            (self._action if step.passed else self._rejected).publish(message)

    def publish_plan(self, server: ModelServer) -> None:
        """Publish what the policy plans and sees, once for each of its answers."""
        plan = server.take_plan()
        if plan is None:
            return
        if plan.unseen and plan.session != self._blind_session:
            self._blind_session = plan.session
            rospy.logwarn("what the policy sees is not shown: %s", plan.unseen)
        if self._plan.get_num_connections():
            self._plan.publish(plan_message(server, plan))

    def publish_status(self, server: ModelServer, refused: str, now: int) -> None:
        """Publish the status on a change, and periodically; ``now`` is the steady clock [ns]."""
        status = (server.state, server.reason, server.waiting, server.session is None, refused)
        if status == self._last and now - self._last_time < STATUS_PERIOD:
            return
        if status[:1] != self._last[:1]:
            self._enabled.publish(Bool(server.state is ServerState.RUNNING))
            rospy.loginfo("policy %s %s", server.state.value, server.reason)
        self._last, self._last_time = status, now
        self._status.publish(policy_status(server, refused, self._address))

    def status_due(self) -> None:
        """Publish the next status even without a change."""
        self._last_time = -STATUS_PERIOD


def plan_message(server: ModelServer, plan: policy_plan.PolicyPlan) -> PolicyPlan:
    """A plan (K, A), and the server's counters."""
    counters, rejected = server.counters, server.steps.last_rejected
    message = PolicyPlan(
        session=plan.session,
        seq=plan.seq,
        step=plan.first,
        period=STEP,
        names=list(server.action_names),
        rows=len(plan.rows),
        values=plan.rows.ravel().tolist(),
        confidence=math.nan,
        accepted=counters.accepted,
        clipped=counters.clipped,
        rejected=counters.rejected.total(),
        late=counters.late,
        stale=counters.stale,
        rule=rejected.rule if rejected else "",
        text=rejected.text if rejected else "",
    )
    message.header.stamp = rospy.Time(*divmod(plan.stamp_ns, SECOND_NS))
    if plan.seen is not None:
        _add_seen(message, plan.seen)
    saturate(message)
    return message


def _add_seen(message: PolicyPlan, seen: Attention) -> None:
    message.picture, message.phase, message.area = seen.picture, seen.phase, list(seen.area)
    if seen.confidence is not None:
        message.confidence = seen.confidence
    for point in seen.keypoints:
        message.keypoints.append(point.name)
        message.x.append(point.x)
        message.y.append(point.y)
        message.certainty.append(point.confidence)
    if seen.heat_map is not None:
        message.map_rows, message.map_columns = seen.heat_map.shape
        message.attention = seen.heat_map.tobytes()
