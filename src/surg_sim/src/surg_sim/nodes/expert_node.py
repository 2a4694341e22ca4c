"""A scripted sender of a task as a node, on the topics that a person uses.

A task has one or more senders (``Task.experts``), each with a name: this node plays the one whose
name it bears. Parameters: ``~cell``, ``~task``, ``~seed`` (of the sender's imperfections),
``~after`` (arms that must be ENABLED before it begins). Exit code 1: it could not connect; 2: a
parameter that must not be used. What made it give up stands on ``~status``; the episode's end is
the simulator's affair.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence

import numpy as np
import rospy

import surg_core
from crtk_msgs.msg import OperatingState
from surg_core.arm_view import ArmCommands
from surg_core.contract import SECOND_NS
from surg_msgs.msg import SenderStatus
from surg_ros.arm_port import SERVO_INSTRUMENT, ArmPort
from surg_ros.params import read
from surg_ros.participant import ASSISTANT, Participant, TickInputs
from surg_sim.nodes import bridge_messages
from surg_sim.nodes.sim_parameters import SenderSettings
from surg_sim.tasks import load
from surg_sim.tasks.scripted_sender import Expert, Observation

COMMANDS = ("state_command", "hold", "jaw/servo_jp", "servo_cp")
"""Topics of an arm that a sender publishes."""


class ExpertNode:
    """Wires a scripted sender, which may command the assistant's instrument, to the topics.

    ``make`` makes the sender by the seed of an episode; another episode has another one.
    """

    def __init__(
        self, make: Callable[[int], Expert], seed: int, assistant: bool, after: Sequence[str] = ()
    ) -> None:
        self._make, self._seed = make, -1  # of the episode that is played; none yet
        self._expert, self._reason = (expert := make(seed)), ""
        self._after, self._awaited = tuple(after), set(after)
        self._ports = {arm: ArmPort(arm, COMMANDS) for arm in expert.arms}
        if assistant:
            self._ports[ASSISTANT] = ArmPort(ASSISTANT, SERVO_INSTRUMENT)
        self._status = rospy.Publisher("~status", SenderStatus, queue_size=10, latch=True)
        self._states = [
            rospy.Subscriber(f"/{arm}/operating_state", OperatingState, self._on_state, arm)
            for arm in after
        ]
        self._participant = Participant(self._ports, self._act, expert.arms, task=True, grid=True)
        self.connect: Callable[[], None] = self._participant.connect

    def _on_state(self, message: OperatingState, arm: str) -> None:
        if message.state == "ENABLED":
            self._awaited.discard(arm)

    def _act(self, seen: TickInputs) -> bool:
        message = seen.task
        if message is not None and message.seed != self._seed:
            if self._seed >= 0:
                self._expert, self._awaited = self._make(message.seed), set(self._after)
            self._seed = message.seed
        if message is None or self._awaited:  # off the grid, or nobody is there to work with
            return False
        arms = {arm: seen.view(arm) for arm in seen.cycles}
        state = bridge_messages.task_state(message.names, message.values)
        action = self._expert.tick(Observation(seen.tick, arms, state, message.phase))
        for arm, commands in action.arms.items():
            commands.stamp_ns = seen.stamp_ns
            self._ports[arm].send(commands)
        if action.assistant is not None:
            joints, jaw = action.assistant.joints, action.assistant.jaw
            servo_jp = None if joints is None else np.asarray(joints)
            self._ports[ASSISTANT].send(ArmCommands(seen.stamp_ns, jaw=jaw, servo_jp=servo_jp))
        if self._expert.reason != self._reason:
            self._reason = self._expert.reason
            stage = SenderStatus.STAGE_FAILED if self._reason else SenderStatus.STAGE_PLAY
            message = SenderStatus(version=SenderStatus.VERSION, stage=stage, detail=self._reason)
            message.header.stamp = rospy.Time(*divmod(time.time_ns(), SECOND_NS))
            self._status.publish(message)
        return False


def main() -> int:
    """Entry point; returns the exit code."""
    rospy.init_node("expert")
    name = rospy.get_name().lstrip("/")
    try:
        settings = read(SenderSettings, rospy.get_param("~", {}))
        task = load(settings.task)
        cell = surg_core.load_cell(settings.cell)
        if name not in (experts := task.experts(cell, settings.seed)):
            known = ", ".join(sorted(experts)) or "none"
            raise ValueError(f"task '{task.name}' has no sender '{name}'; there are: {known}")
    except (ValueError, OSError) as error:
        print(f"surg_sim: {error}", file=sys.stderr, flush=True)
        return 2

    def make(seed: int) -> Expert:
        return task.experts(cell, seed)[name]

    node = ExpertNode(make, settings.seed, name == ASSISTANT, settings.after)
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
