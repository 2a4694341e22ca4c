"""The bridge's topics of a task: its state, and what force sensors measure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from geometry_msgs.msg import WrenchStamped

from surg_core.contract import FORCE_TICKS, GRID
from surg_msgs.msg import TaskState, TaskStatus
from surg_ros import link_messages
from surg_ros.byte_topics import BytesPublisher
from surg_sim.nodes import bridge_messages
from surg_sim.nodes.assistant_topics_node import AssistantTopics
from surg_sim.physics.assistant_arm import AssistantCommand
from surg_sim.physics.stability import trouble
from surg_sim.physics.world import World
from surg_sim.tasks import Verdict

if TYPE_CHECKING:
    from surg_sim.nodes.sim_bridge_node import Bridge
    from surg_sim.nodes.sim_parameters import BridgeSettings


class _ForceSensor:
    """A force sensor at the ``trocar`` or the ``tool`` of an arm.

    ``read`` gives the force in the arm's base frame [N], (3,); ``lockstep``: slow receivers are
    waited for.
    """

    def __init__(self, arm: str, place: str, read: Callable[[str], Any], lockstep: bool) -> None:
        self.arm, self._frame, self._read = arm, link_messages.text(f"{arm}_base"), read
        self.topic = f"/{arm}/{place}/measured_cf"
        self.output = BytesPublisher(self.topic, WrenchStamped, lockstep)

    def publish(self, tick: int, stamp_ns: int) -> None:
        """The force in the state that is there."""
        if self.output.connections:
            force = self._read(self.arm)
            self.output.send(bridge_messages.pack_wrench(stamp_ns, tick, self._frame, force))


class TaskTopics:
    """A task's state and verdict, its assistant, and what force sensors would say."""

    def __init__(self, bridge: Bridge, world: World, settings: BridgeSettings) -> None:
        assert world.task is not None
        self._world, self._task, self._setting = world, world.task, settings.setting
        self.seed = settings.seed
        """Of the episode."""
        self._layout = bridge_messages.TaskStateLayout(self._task.state())
        # Latched: a sender that takes part counts itself connected a moment before this side does,
        # and a state of the grid is sent once.
        self._state = BytesPublisher("/sim/task_state", TaskState, bridge.lockstep, latch=True)
        self._assistant = None if self._task.assistant is None else AssistantTopics(bridge)
        lockstep = bridge.lockstep
        # An arm with a sensor at its flange is told what that sensor makes of it.
        sensed = [] if lockstep else list(world.force_sensors)
        # People begin when they are ready, minutes after the phantom: no time limit for them.
        self._unhurried = settings.endless and not lockstep
        self._free = not lockstep  # in free-run an end is news once, also where the phantom goes on
        self._forces = [
            _ForceSensor(name, "trocar", lambda arm: world.trocar(arm).force, lockstep)
            for name in world.arms
            if name not in sensed
        ] + [
            _ForceSensor(name, "tool", world.tip_force, lockstep)
            for name in world.arms
            if world.tip_force(name) is not None and name not in sensed
        ]
        self.verdict = self._judged()
        """How the episode stands at the state that is out."""

    def begin_next(self) -> None:
        """Begin the next seed's episode, arms at home; ticks go on: receivers take none twice."""
        self.seed, tick = self.seed + 1, self._world.tick
        self._world.reset(self.seed)
        self.verdict = self._judged()
        self._world.tick = tick

    def _judged(self) -> Verdict:
        """How the task stands."""
        verdict = self._task.verdict()
        if verdict.timeout and self._unhurried:
            return replace(verdict, done=False, timeout=False, reason="")
        return verdict

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
        verdict = self.verdict = self._judged()
        if tick % GRID == 0 or (verdict.done and not (ended and self._free)):
            self._state.send(
                self._layout.pack(stamp_ns, tick, self.seed, self._task.state(), verdict)
            )
        if self._assistant is not None:
            instrument = self._task.assistant
            self._assistant.publish(tick, stamp_ns, instrument.joints, instrument.jaw)

    def publish_forces(self, tick: int, stamp_ns: int) -> None:
        """What the force sensors at trocars and jaws measured in a state that has been answered.

        A controller takes the newest sample that it has. Sent between its answer and the next
        state, a sample counts from the next cycle on, in every run.
        """
        if tick % FORCE_TICKS == 0:
            for sensor in self._forces:
                sensor.publish(tick, stamp_ns)

    def unconnected(self, controllers: Mapping[str, set[str]]) -> list[str]:
        """Sentences about the force sensors that a controller does not listen to yet.

        Names of the nodes that answer for an arm, by arm.
        """
        return [
            f"the controller does not subscribe {sensor.topic}"
            for sensor in self._forces
            if not sensor.output.listeners & controllers[sensor.arm]
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
            seed=self.seed,
            phase=verdict.phase,
            detail=verdict.reason,
        )
