"""Topics by which a dVRK console states its teleoperation: scale, selected, unselected.

A pair is one leader on one arm, named ``<leader>_<arm>``. All pairs are selected at the start.
``/console/teleop/enable`` and a leader's own button enable selected pairs only.
"""

from __future__ import annotations

from typing import Any

import rospy
from std_msgs.msg import Float64, String

from surg_teleop.follow.arm_switch import Hand


class ConsoleTopics:
    """Publishes scale and selection; a client that connects late hears of every pair.

    Args:
        hands: Leaders with their arms.
    """

    def __init__(self, hands: list[Hand]) -> None:
        self._pairs = {
            f"{hand.leader.name}_{arm}": teleop
            for hand in hands
            for arm, teleop in hand.switch.arms.items()
        }
        self._unselected: set[str] = set()
        keys: dict[str, Any] = {"queue_size": 20, "tcp_nodelay": True}
        self._scale = rospy.Publisher("/console/teleop/scale", Float64, latch=True, **keys)
        self._topics = {
            selected: rospy.Publisher(
                f"/console/teleop/{name}",
                String,
                subscriber_listener=_Greeting(lambda s=selected: self._which(s)),  # type: ignore[misc]
                **keys,
            )
            for selected, name in ((True, "selected"), (False, "unselected"))
        }
        self._stated: float | None = None

    def may_enable(self, pair: str) -> bool:
        """Whether the pair is selected."""
        return pair not in self._unselected

    def select(self, pair: str, selected: bool) -> str:
        """Select or unselect a pair; unselecting disables it. Returns why not, or ""."""
        if pair not in self._pairs:
            return f"no pair '{pair}' to select; allowed: {', '.join(self._pairs)}"
        if selected:
            self._unselected.discard(pair)
        else:
            self._unselected.add(pair)
            self._pairs[pair].disable()
        self._topics[selected].publish(pair)
        return ""

    def publish_scale(self) -> None:
        """Publish the scale of the first pair if it has changed."""
        scale = next(iter(self._pairs.values())).scale
        if scale != self._stated:
            self._stated = scale
            self._scale.publish(scale)

    def _which(self, selected: bool) -> list[str]:
        return [pair for pair in self._pairs if self.may_enable(pair) is selected]


class _Greeting(rospy.SubscribeListener):  # type: ignore[misc]
    """Sends the pairs of a topic to each new subscriber."""

    def __init__(self, pairs: Any) -> None:
        super().__init__()
        self._pairs = pairs

    def peer_subscribe(self, _topic: str, _publish: Any, publish_to_peer: Any) -> None:
        for pair in self._pairs():
            publish_to_peer(String(pair))
