"""A second sender to an arm, in a process of its own and in lock-step."""

from __future__ import annotations

import json
import sys

import rospy

from surg_core.arm_view import ArmCommands, TipPose
from surg_ros.arm_port import ArmPort
from surg_ros.participant import Participant, TickInputs

ASIDE = (0.0, 0.001, 0.0)
"""Offset of the stream from the measured tip in the trocar frame [m]: it would be accepted."""


def main(argv: list[str]) -> int:
    """Carry out a plan, given as JSON: words by tick.

    `stream` and `quiet` start and end a servo_cp in every tick; `hold` goes to its own topic, every
    other word to state_command.
    """
    rospy.init_node("stranger")
    plan: dict[str, list[str]] = json.loads(argv[1])
    port = ArmPort("PSM1")
    streaming = False

    def act(seen: TickInputs) -> bool:
        nonlocal streaming
        for word in plan.get(str(seen.tick + 1), []):
            if word in ("stream", "quiet"):
                streaming = word == "stream"
            elif word == "hold":
                port.send(ArmCommands(seen.stamp_ns, hold=True))
            else:
                port.send(ArmCommands(seen.stamp_ns, state=word))
        if streaming:
            view = seen.view("PSM1")
            assert view.R_BR is not None
            tip = view.R_BR.T @ (view.p_BTip - view.p_BRcm)
            port.send(ArmCommands(seen.stamp_ns, servo_cp=TipPose(tip + ASIDE, view.roll)))
        return False

    participant = Participant({"PSM1": port}, act, arms=["PSM1"])
    participant.connect()
    rospy.spin()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv))
