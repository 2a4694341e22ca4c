"""The bridge's topics of a task: its state, the assistant's instrument, measured forces."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import rospy
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState

from surg_core.contract import GRID
from surg_msgs.msg import TaskState, TaskStatus
from surg_ros.transport.direct_publisher import DirectPublisher
from surg_sim.envs.cell_session import FORCE_TICKS
from surg_sim.nodes import bridge_messages
from surg_sim.nodes.arm_topics_node import JointStateBytes
from surg_sim.nodes.command_echo import CommandEcho
from surg_sim.physics.assistant_arm import AssistantCommand
from surg_sim.physics.stability import trouble
from surg_sim.physics.world import World
from surg_sim.tasks import Verdict

if TYPE_CHECKING:
    from surg_sim.nodes.sim_bridge_node import Bridge

_JAW = bridge_messages.JointStateLayout(["jaw"])


class AssistantTopics:
    """The assistant's instrument: what it measures, and the commands that wait for their tick.

    In lock-step a participant's command carries the stamp of the tick it is for: it may come before
    the tick in front of it is executed. Anybody else's is obeyed at once; in free-run what is late,
    because a network held it up, is not.
    """

    def __init__(self, bridge: Bridge) -> None:
        self._bridge = bridge
        # Tick, sender, what, value; in free-run put in without a lock (see latest_value.py).
        self._waiting: deque[tuple[int, str, str, Any]] = deque()
        self._state = DirectPublisher("/assistant/measured_js", JointState, bridge.lockstep)
        self._jaw = DirectPublisher("/assistant/jaw/measured_js", JointState, bridge.lockstep)
        self._layout = bridge_messages.JointStateLayout(["yaw", "pitch", "insertion", "roll"])
        self._command_echo = CommandEcho()

        def listen(topic: str, what: str, size: int) -> Any:
            def callback(message: Any) -> None:
                sender = str(message._connection_header.get("callerid", "")).lstrip("/")
                try:
                    stamp_ns, position, _ = bridge_messages.unpack_joint_state(message.data)
                    if len(position) != size or not np.isfinite(position).all():
                        raise ValueError(f"{position}, allowed: {size} finite numbers")
                    if not bridge.lockstep and self._command_echo.is_late(stamp_ns):
                        raise ValueError(
                            "late: it answers a state of more than 0.1 s ago; not obeyed"
                        )
                except (struct.error, ValueError) as error:
                    rospy.logwarn_throttle(1.0, f"/assistant/{topic} from {sender}: {error}")
                    position, stamp_ns = None, 0
                bridge.on_assistant(self, sender, stamp_ns, what, position)

            return rospy.Subscriber(
                f"/assistant/{topic}", JointStateBytes, callback, tcp_nodelay=True
            )

        self._inputs = [listen("servo_jp", "joints", 4), listen("jaw/servo_jp", "jaw", 1)]

    def keep(self, tick: int, sender: str, what: str, value: Any) -> None:
        """A command for a tick; 0: for the next one."""
        self._waiting.append((tick, sender, what, value))

    def take(self, tick: int) -> AssistantCommand | None:
        """What is for this tick: of each kind the newest, whatever the order of arrival was."""
        here = [self._waiting.popleft() for _ in range(len(self._waiting))]
        self._waiting.extend(w for w in here if w[0] > tick)
        due = sorted((w for w in here if w[0] <= tick), key=lambda w: w[:2])
        if not due:
            return None
        newest = {what: value for _, _, what, value in due}
        jaw = newest.get("jaw")
        return AssistantCommand(newest.get("joints"), None if jaw is None else float(jaw[0]))

    def publish(self, tick: int, stamp_ns: int, joints: Any, jaw: float) -> None:
        """What the instrument measures."""
        self._command_echo.record(stamp_ns)
        if self._state.connections:
            self._state.send(self._layout.pack(tick, stamp_ns, joints, np.zeros(0)))
        if self._jaw.connections:
            self._jaw.send(_JAW.pack(tick, stamp_ns, np.array([jaw]), np.zeros(0)))


class _ForceSensor:
    """A force sensor of one arm.

    Args:
        arm: Whose.
        place: ``trocar`` or ``tool``.
        read: The force in the arm's base frame [N], (3,).
        patient: Whether a slow receiver is waited for.
    """

    def __init__(self, arm: str, place: str, read: Callable[[str], Any], patient: bool) -> None:
        self.arm, self._frame, self._read = arm, bridge_messages.text(f"{arm}_base"), read
        self._output = DirectPublisher(f"/{arm}/{place}/measured_cf", WrenchStamped, patient)
        self.topic = f"/{arm}/{place}/measured_cf"

    @property
    def listeners(self) -> set[str]:
        """Names of the nodes that subscribe."""
        return self._output.listeners

    def publish(self, tick: int, stamp_ns: int) -> None:
        """The force in the state that is there."""
        if self._output.connections:
            force = self._read(self.arm)
            self._output.send(bridge_messages.pack_wrench(stamp_ns, tick, self._frame, force))


class TaskTopics:
    """A task's state and verdict, its assistant, and what force sensors would say.

    Args:
        bridge: Receives the commands to the assistant.
        world: With a task in it.
        setting: Name of the physical setting, for the status.
    """

    def __init__(self, bridge: Bridge, world: World, setting: str) -> None:
        assert world.task is not None
        self._world, self._task, self._setting = world, world.task, setting
        self._layout = bridge_messages.TaskStateLayout(self._task.state())
        # Latched: a sender that takes part counts itself connected a moment before this side does,
        # and a state of the grid is sent once.
        self._state = DirectPublisher("/sim/task_state", TaskState, bridge.lockstep, latch=True)
        self._assistant = None if self._task.assistant is None else AssistantTopics(bridge)
        patient = bridge.lockstep
        self._free = not patient  # in free-run an end is news once, also where the phantom goes on
        self._forces = [
            _ForceSensor(name, "trocar", lambda arm: world.trocar(arm).force, patient)
            for name in world.arms
        ] + [
            _ForceSensor(name, "tool", world.tip_force, patient)
            for name in world.arms
            if world.tip_force(name) is not None
        ]
        self.verdict = self._task.verdict()
        """How the episode stands at the state that is out."""

    def take(self, tick: int) -> AssistantCommand | None:
        """What the assistant shall do in this tick."""
        return None if self._assistant is None else self._assistant.take(tick)

    def distrust(self) -> bool:
        """After a step: whether the simulation has become unstable, which ends the episode."""
        why = trouble(self._world.data)
        if why:
            self.verdict = Verdict(done=True, reason=why, phase=self.verdict.phase)
        return bool(why)

    def publish(self, tick: int, stamp_ns: int) -> None:
        """Judge the state of a tick; send it on the grid and when the episode ends with it."""
        ended = self.verdict.done
        verdict = self.verdict = self._task.verdict()
        if tick % GRID == 0 or (verdict.done and not (ended and self._free)):
            outcome = (verdict.done, verdict.success, verdict.reason)
            self._state.send(
                self._layout.pack(
                    stamp_ns, tick, self._task.state(), verdict.phase, outcome, verdict.reward
                )
            )
        if self._assistant is not None:
            instrument = self._task.assistant
            self._assistant.publish(tick, stamp_ns, instrument.joints, instrument.jaw)

    def publish_forces(self, tick: int, stamp_ns: int) -> None:
        """What the force sensors at trocars and jaws measured in a state that has been answered.

        A controller takes the newest sample that it has. Sent between its answer and the next
        state, a sample counts from the next cycle on, in every run.
        """
        if tick % FORCE_TICKS:
            return
        for sensor in self._forces:
            sensor.publish(tick, stamp_ns)

    def unconnected(self, controllers: Mapping[str, set[str]]) -> list[str]:
        """Sentences about the force sensors that a controller does not listen to yet.

        Args:
            controllers: Names of the nodes that answer for an arm, by arm.
        """
        return [
            f"the controller does not subscribe {sensor.topic}"
            for sensor in self._forces
            if not sensor.listeners & controllers[sensor.arm]
        ]

    def status(self) -> TaskStatus:
        """For ``/sim/status``."""
        verdict, state = self.verdict, TaskStatus.STATE_RUNNING
        if verdict.done:
            state = TaskStatus.STATE_SUCCESS if verdict.success else TaskStatus.STATE_FAILURE
        return TaskStatus(
            state=state,
            name=self._task.name,
            setting=self._setting,
            phase=verdict.phase,
            detail=verdict.reason,
        )
