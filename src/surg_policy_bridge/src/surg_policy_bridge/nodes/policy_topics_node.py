"""Topics of the policy: its judged steps, whether it is enabled, and its status."""

from __future__ import annotations

from collections.abc import Sequence

import rospy
from std_msgs.msg import Bool

from surg_core.contract import ARM_ACTION, SECOND_NS
from surg_msgs.msg import PolicyAction, PolicyStatus
from surg_policy_bridge.nodes.policy_status_node import policy_status
from surg_policy_bridge.server.model_server import ModelServer, State

STATUS_PERIOD = SECOND_NS // 2
"""[ns] Longest interval between two status messages."""


class PolicyTopics:
    """Publishers of ``/policy``, for the arms of a policy and the server's address."""

    def __init__(self, arms: Sequence[str], address: str) -> None:
        out = rospy.Publisher
        self._names = [f"{arm}/{name}" for arm in arms for name in ARM_ACTION]
        self._address = address
        self._action = out("/policy/action", PolicyAction, queue_size=0, tcp_nodelay=True)
        self._rejected = out("/policy/rejected", PolicyAction, queue_size=0, tcp_nodelay=True)
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
                names=self._names,
                values=step.values.tolist(),
                rule=step.rule,
                text=step.text,
            )
            message.header.stamp = rospy.Time(*divmod(stamp_ns, SECOND_NS))
            (self._action if step.passed else self._rejected).publish(message)

    def publish_status(self, server: ModelServer, refused: str, now: int) -> None:
        """Publish the status on a change, and periodically; ``now`` is the steady clock [ns]."""
        status = (server.state, server.reason, server.waiting, server.session is None, refused)
        if status == self._last and now - self._last_time < STATUS_PERIOD:
            return
        if status[:1] != self._last[:1]:
            self._enabled.publish(Bool(server.state is State.RUNNING))
            rospy.loginfo("policy %s %s", server.state.value, server.reason)
        self._last, self._last_time = status, now
        self._status.publish(policy_status(server, refused, self._address))

    def status_due(self) -> None:
        """Publish the next status even without a change."""
        self._last_time = -STATUS_PERIOD
