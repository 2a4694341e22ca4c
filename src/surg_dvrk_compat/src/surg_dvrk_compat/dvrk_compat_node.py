"""The node ``/dvrk_compat``: provides the topics that unmodified dVRK clients require.

It moves nothing: it publishes only warnings on ``<arm>/warning`` and ``/system/warning`` and, once,
the feedback of ``interface.FEEDBACK``.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import roslib.message
import rospy
from std_msgs.msg import String

from surg_dvrk_compat.interface import (
    COMMANDS,
    FEEDBACK,
    SYSTEM_COMMANDS,
    Command,
    Throttle,
    answer,
)
from surg_ros.params import ParamError, names, read


class IgnoredCommands:
    """Command topics below one name, answered on its ``warning``.

    Args:
        owner: An arm, or ``system``.
        commands: What is ignored.
    """

    def __init__(self, owner: str, commands: Sequence[Command]) -> None:
        self._owner = owner
        self._throttle = Throttle()
        self._warning = rospy.Publisher(f"/{owner}/warning", String, queue_size=100)
        self._subscribers = [
            rospy.Subscriber(
                f"/{owner}/{command.topic}",
                roslib.message.get_message_class(command.type),
                self._ignore(command),
            )
            for command in commands
        ]

    def _ignore(self, command: Command) -> Callable[[Any], None]:
        def callback(message: Any) -> None:
            sender = message._connection_header.get("callerid", "somebody")
            if self._throttle.passes(f"{command.topic} {sender}", time.monotonic()):
                self._warning.publish(String(answer(self._owner, command, sender)))

        return callback


class Compatibility:
    """The topics of one arm."""

    def __init__(self, arm: str) -> None:
        self._ignored = IgnoredCommands(arm, COMMANDS)
        self._publishers = []
        for feedback in FEEDBACK:
            kind = roslib.message.get_message_class(feedback.type)
            publisher = rospy.Publisher(f"/{arm}/{feedback.topic}", kind, latch=True, queue_size=1)
            if feedback.value == "invalid":
                publisher.publish(kind())  # stamp 0
            elif feedback.value is not None:
                publisher.publish(kind(feedback.value))
            self._publishers.append(publisher)


@dataclass(frozen=True)
class Parameters:
    """Parameters of the node."""

    arms: tuple[str, ...] = names(least=1)


def main() -> int:
    """Run the node; returns the exit code (0: ended, 2: invalid parameter)."""
    rospy.init_node("dvrk_compat")
    try:
        arms = read(Parameters, rospy.get_param("~", {})).arms
    except ParamError as error:
        print(f"dvrk_compat: {error}; such as _arms:=PSM1", file=sys.stderr, flush=True)
        return 2
    held: list[object] = [Compatibility(arm.strip().strip("/")) for arm in arms]
    held.append(IgnoredCommands("system", SYSTEM_COMMANDS))
    rospy.loginfo(f"dvrk_compat: answers for {', '.join(arms)}; moves nothing")
    rospy.spin()
    return 0


if __name__ == "__main__":
    sys.exit(main())
