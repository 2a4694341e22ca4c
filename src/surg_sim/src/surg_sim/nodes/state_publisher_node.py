"""Publishes the state of a tick: clock, task, links, joint states, ground truth, snapshot."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import replace

import rospy
from geometry_msgs.msg import WrenchStamped
from rosgraph_msgs.msg import Clock

import surg_core
from surg_core.contract import SECOND_NS, TICK_NS
from surg_msgs.msg import GroundTruth, Ready, SimSnapshot
from surg_ros import link_messages
from surg_ros.byte_topics import BytesPublisher, listeners
from surg_sim.nodes import bridge_messages
from surg_sim.nodes.arm_topics_node import ArmTopics
from surg_sim.nodes.exposure_schedule import ExposureSchedule
from surg_sim.nodes.fault_injector import Injector
from surg_sim.nodes.task_topics_node import TaskTopics
from surg_sim.physics.sim_arm import ArmLink
from surg_sim.physics.world import World

_STATUS_TICKS = 10
"""50 Hz."""

Message = tuple[BytesPublisher, bytes]
"""What is to be sent."""


class StatePublisher:
    """Publishes states; in lock-step, slow subscribers are waited for.

    Create it after the task's topics: a subscriber of ground truth then knows of the task.
    """

    def __init__(
        self,
        world: World,
        injector: Injector,
        arms: Sequence[ArmTopics],
        task: TaskTopics | None,
        exposures: ExposureSchedule,
        lockstep: bool,
    ) -> None:
        self._world, self._injector, self._arms, self._task = world, injector, arms, task
        self._exposures, self._lockstep = exposures, lockstep
        self.stamp_ns = 0
        """Stamp of the state that was published last."""
        self._clock = BytesPublisher("/clock", Clock, lockstep)
        self._snapshot = rospy.Publisher(
            "/sim/snapshot", SimSnapshot, queue_size=0 if lockstep else 2, tcp_nodelay=True
        )
        # In lock-step a tracker is a participant like any sender of commands, named as this node.
        self._name = rospy.get_name().lstrip("/")
        self._tracker: rospy.Publisher | None = None
        if lockstep and any(arm.track is not None for arm in arms):
            self._tracker = rospy.Publisher("/sim/ready", Ready, queue_size=0, tcp_nodelay=True)
        self._flanges = None if lockstep else FlangeTopics(world)
        self._truth = BytesPublisher("/sim/ground_truth/state", GroundTruth, lockstep)

    def publish(self, stamp_ns: int) -> None:
        """Publish the present state of the world with this stamp."""
        tick, world = self._world.tick, self._world
        self.stamp_ns = stamp_ns
        if self._clock.connections:
            self._clock.send(struct.pack("<2I", *divmod(stamp_ns, SECOND_NS)))
        links = [message for arm in self._arms for message in self._links(arm, tick, stamp_ns)]
        if self._task is not None:
            self._task.publish(tick, stamp_ns)
        if self._tracker is not None:
            names, sent = [arm.name for arm in self._arms], [arm.tracked for arm in self._arms]
            self._tracker.publish(Ready(tick=tick, participant=self._name, arms=names, sent=sent))
        if self._flanges is not None:
            self._flanges.publish(tick, stamp_ns)
        # The joint states go last: their arrival starts the controller's work. All leave together,
        # so that a controller wakes once.
        for arm in self._arms:
            for stamp, state in self._injector.states(arm.name, stamp_ns):
                links.append((arm.state, arm.layout.pack(tick, stamp, state.q, state.qd)))
        for publisher, data in links:
            publisher.send(data)
        # Observers' messages are made while the controllers work.
        if self._truth.connections:
            truths = ((arm.name, world.truth(arm.name)) for arm in self._arms)
            self._truth.send(bridge_messages.pack_ground_truth(stamp_ns, tick, truths))
        if self._exposures.due(tick):
            seed = 0 if self._task is None else self._task.seed
            snapshot = SimSnapshot(tick=tick, seed=seed, qpos=world.data.qpos.tolist())
            snapshot.header.stamp = rospy.Time(*divmod(stamp_ns, SECOND_NS))
            self._snapshot.publish(snapshot)

    def _links(self, arm: ArmTopics, tick: int, stamp_ns: int) -> list[Message]:
        """Jaw, link status and trocar track of one arm."""
        injector, messages = self._injector, list[Message]()
        tool = injector.tool(arm.name) if tick % arm.tool_ticks == 0 else None
        if tool is not None:
            messages.append((arm.tool, arm.tool_layout.pack(tick, stamp_ns, *tool)))
        if arm.status.connections and injector.speaks(arm.name):
            messages += self._status(arm, self._world.link(arm.name), tick, stamp_ns)
        observation = None if arm.track is None else injector.track(arm.name, arm.stale)
        if arm.track is not None and observation is not None:
            observed_tick, *motion = observation
            observed_ns = stamp_ns - (tick - observed_tick) * TICK_NS
            arm.tracked += 1
            packed = bridge_messages.pack_point_velocity(observed_ns, tick, arm.frame, *motion)
            messages.append((arm.track, packed))
        return messages

    def _status(self, arm: ArmTopics, link: ArmLink, tick: int, stamp_ns: int) -> list[Message]:
        """The link's status: in lock-step part of every tick, else on change and at 50 Hz."""
        condition, scaling = self._injector.robot(arm.name)
        says = link_messages.LinkSays(
            condition=condition.value,
            command=arm.command,
            last_command_ns=arm.last_command_ns,
            dead_man=link.dead_man,
            lockstep=self._lockstep,
            fault=surg_core.condition_sentence(condition) or link.fault,
            speed_scaling=scaling,
        )
        if not self._lockstep:
            unchanged = replace(says, last_command_ns=0)
            if tick % _STATUS_TICKS != 0 and unchanged == arm.said:
                return []
            arm.said = unchanged
        return [(arm.status, says.pack(stamp_ns, tick))]

    def unconnected(
        self, observers: Sequence[str], ready: set[str], controllers: Mapping[str, set[str]]
    ) -> list[str]:
        """One sentence per missing connection.

        Declared observers, nodes that publish /sim/ready, and the nodes that control each arm.
        """
        missing = []
        if self._tracker is not None:
            connected = listeners(self._tracker)
            missing += [
                f"the controller of {name} does not subscribe /sim/ready"
                for name, nodes in controllers.items()
                if not connected & nodes
            ]
        if "recorder" in observers and not self._truth.listeners & ready:
            missing.append("the recorder does not subscribe /sim/ground_truth/state")
        if "endoscope" in observers and not listeners(self._snapshot) & ready:
            missing.append("the endoscope does not subscribe /sim/snapshot")
        return missing


class FlangeTopics:
    """``<arm>/flange/measured_cf`` of every arm that has a force sensor there, in free-run."""

    def __init__(self, world: World) -> None:
        self._outputs = [
            (
                sensor,
                link_messages.text(f"{name}_force_sensor"),
                BytesPublisher(f"/{name}/flange/measured_cf", WrenchStamped, blocking=False),
            )
            for name, sensor in world.force_sensors.items()
        ]

    def publish(self, tick: int, stamp_ns: int) -> None:
        """The readings of the state that is there."""
        for sensor, frame, output in self._outputs:
            if output.connections:
                force, torque = sensor.reading[:3], sensor.reading[3:]
                output.send(bridge_messages.pack_wrench(stamp_ns, tick, frame, force, torque))
