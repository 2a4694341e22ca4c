"""A scripted sender of a task as a node, on the topics that a person uses; in lock-step only.

A task has one or more senders (``Task.experts``), each with a name: this node plays the one whose
name it bears. Parameters: ``~cell``, ``~task``, ``~seed`` (of the sender's imperfections). Exit
code 1: it could not connect; 2: a parameter that must not be used. What made it give up stands on
``~status``; the episode's end is the simulator's affair.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty

import surg_core
from crtk_msgs.msg import StringStamped
from surg_msgs.msg import Cycle, SenderStatus
from surg_ros.params import read
from surg_ros.participant import ASSISTANT, Participant, Seen
from surg_sim.nodes import bridge_messages
from surg_sim.nodes.sim_parameters import SenderSettings
from surg_sim.physics.assistant_arm import JOINTS, AssistantCommand
from surg_sim.tasks import load
from surg_sim.tasks.scripted_sender import ArmAction, ArmView, Expert, Observation

ARM_COMMANDS: dict[str, type] = {
    "state_command": StringStamped,
    "hold": Empty,
    "jaw/servo_jp": JointState,
    "servo_cp": PoseStamped,
}
ASSISTANT_COMMANDS: dict[str, type] = {"servo_jp": JointState, "jaw/servo_jp": JointState}


def arm_view(cycle: Cycle) -> ArmView:
    """What a sender looks at in a cycle message."""
    return ArmView(
        state=cycle.state,
        homed=cycle.homed,
        reason=cycle.reason,
        p_tip=np.array(cycle.p_tip),
        s=np.array(cycle.s),
        p_set=np.array(cycle.p_set),
        roll=cycle.roll,
        roll_set=cycle.roll_set,
        jaw=cycle.jaw,
    )


class ExpertNode:
    """Wires a scripted sender to the topics.

    Args:
        expert: The sender.
        assistant: Whether it commands the assistant's instrument.
    """

    def __init__(self, expert: Expert, assistant: bool) -> None:
        self._expert, self._reason = expert, ""
        commands = {f"/{arm}/{t}": kind for arm in expert.arms for t, kind in ARM_COMMANDS.items()}
        if assistant:
            commands.update({f"/{ASSISTANT}/{t}": k for t, k in ASSISTANT_COMMANDS.items()})
        self._status = rospy.Publisher("~status", SenderStatus, queue_size=10, latch=True)
        self._participant = Participant(expert.arms, commands, self._act, task=True)
        self.connect: Callable[[], None] = self._participant.connect

    def _act(self, seen: Seen) -> bool:
        if not seen.task:  # off the grid: nobody looks, nobody acts
            return False
        message = seen.task_state()
        arms = {arm: arm_view(seen.cycle(arm)) for arm in seen.cycles}
        state = bridge_messages.task_state(message.names, message.values)
        action = self._expert.tick(Observation(seen.tick, arms, state, message.phase))
        for arm, arm_action in action.arms.items():
            self._send_to_arm(arm, arm_action, seen.stamp)
        if action.assistant is not None:
            self._send_to_assistant(action.assistant, seen.stamp)
        if self._expert.reason != self._reason:
            self._reason = self._expert.reason
            stage = SenderStatus.STAGE_FAILED if self._reason else SenderStatus.STAGE_PLAY
            message = SenderStatus(version=SenderStatus.VERSION, stage=stage, detail=self._reason)
            message.header.stamp = rospy.Time(*divmod(time.time_ns(), bridge_messages.NS))
            self._status.publish(message)
        return False

    def _send_to_arm(self, arm: str, arm_action: ArmAction, stamp: rospy.Time) -> None:
        def send(topic: str, message: Any) -> None:
            message.header.stamp = stamp
            self._participant.send(f"/{arm}/{topic}", message)

        if arm_action.state is not None:
            send("state_command", StringStamped(string=arm_action.state))
        if arm_action.hold:
            self._participant.send(f"/{arm}/hold", Empty())
        if arm_action.jaw is not None:
            send("jaw/servo_jp", JointState(name=["jaw"], position=[arm_action.jaw]))
        if arm_action.p is not None and arm_action.q is not None:
            message = PoseStamped()
            position, orientation = message.pose.position, message.pose.orientation
            position.x, position.y, position.z = arm_action.p.tolist()
            orientation.x, orientation.y, orientation.z, orientation.w = arm_action.q.tolist()
            send("servo_cp", message)

    def _send_to_assistant(self, command: AssistantCommand, stamp: rospy.Time) -> None:
        def send(topic: str, names: list[str], position: list[float]) -> None:
            message = JointState(name=names, position=position)
            message.header.stamp = stamp
            self._participant.send(f"/{ASSISTANT}/{topic}", message)

        if command.joints is not None:
            send("servo_jp", list(JOINTS), np.asarray(command.joints).tolist())
        if command.jaw is not None:
            send("jaw/servo_jp", ["jaw"], [command.jaw])


def main() -> int:
    """Entry point; returns the exit code."""
    rospy.init_node("expert")
    name = rospy.get_name().lstrip("/")
    try:
        settings = read(SenderSettings, rospy.get_param("~", {}))
        task = load(settings.task)
        experts = task.experts(surg_core.load_cell(settings.cell), settings.seed)
        if name not in experts:
            known = ", ".join(sorted(experts)) or "none"
            raise ValueError(f"task '{task.name}' has no sender '{name}'; there are: {known}")
    except (ValueError, OSError) as error:
        print(f"surg_sim: {error}", file=sys.stderr, flush=True)
        return 2
    node = ExpertNode(experts[name], assistant=name == ASSISTANT)
    try:
        node.connect()
    except (TimeoutError, OSError) as error:
        print(f"surg_sim: {error}", file=sys.stderr, flush=True)
        return 1
    while not rospy.is_shutdown():
        time.sleep(0.1)
    return 0


if __name__ == "__main__":
    sys.exit(main())
