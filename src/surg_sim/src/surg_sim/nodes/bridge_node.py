"""The node ``/sim``: the world behind the robot-link contract, in lock-step or in real time.

In lock-step the thread that receives the last missing answer executes the tick and publishes the
next state itself: no timer, no hand-over. In free-run one loop ticks at 500 Hz by the steady clock.
Nothing is ever rendered here. Faults on purpose (``~faults``, ``/sim/inject``) are the injector's;
they are taken where the ROS master is on this machine only.
"""

from __future__ import annotations

import os
import struct
import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from typing import Any
from urllib.parse import urlparse

import mujoco
import rospy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String

import surg_core
from surg_core.contract import SECOND_NS, TICK_NS
from surg_msgs.msg import (
    GroundTruth,
    LinkStatus,
    PointVelocityStamped,
    Ready,
    SimSnapshot,
    SimStatus,
    TaskStatus,
)
from surg_ros.params import read
from surg_ros.transport.direct_publisher import DirectPublisher, listeners, speakers
from surg_ros.transport.polled_subscriber import PolledSubscriber
from surg_ros.transport.raw_message import RawJointState, RawTwist
from surg_sim import tasks
from surg_sim.nodes import bridge_messages
from surg_sim.nodes.exposure_schedule import RENDERER, ExposureSchedule
from surg_sim.nodes.latest_value import LatestValue
from surg_sim.nodes.lockstep import OBSERVER_WINDOWS, Action, Lockstep
from surg_sim.nodes.sim_parameters import BridgeSettings
from surg_sim.nodes.task_topics_node import AssistantTopics, TaskTopics
from surg_sim.physics import faults, patient_settings
from surg_sim.physics.fault_injector import Injector, tool_errors
from surg_sim.physics.hand_guiding import HandGuiding
from surg_sim.physics.sim_arm import ArmCommand
from surg_sim.physics.world import World

_JAWLESS_TICKS = 5
"""In free-run the link of an instrument without a jaw speaks every 5th tick: 100 Hz."""
_STATUS_PERIOD = 0.2  # [s] wall
_LATE = 0.05  # [s] free-run gives up catching up when it is later than this


_Arrived = tuple[int, Any, Any]
"""A command: stamp [ns], joint velocities or jaw, twist; what it does not have is None."""


class _ArmTopics:
    """Topics of one arm, and the commands that wait for their tick."""

    def __init__(self, bridge: Bridge, arm: surg_core.Arm) -> None:
        patient = bridge.lockstep
        self.name: str = arm.name
        self.command = arm.robot.command.name.lower()
        self.layout = bridge_messages.JointStateLayout(list(arm.robot.joint_names))
        self.last_command_ns = 0
        self.arrived: dict[str, LatestValue[_Arrived]] = {
            "robot": LatestValue(),
            "tool": LatestValue(),
        }
        root = f"/{arm.name}"
        self.state = DirectPublisher(f"{root}/robot/measured_js", JointState, patient)
        self.status = DirectPublisher(f"{root}/robot/status", LinkStatus, patient)
        self.tool = DirectPublisher(f"{root}/tool/measured_js", JointState, patient)
        jaw = arm.instrument.jaw_min < arm.instrument.jaw_max
        self.tool_ticks = 1 if bridge.lockstep or jaw else _JAWLESS_TICKS

        # In free-run the tick fetches the commands itself.
        self._polled: list[tuple[PolledSubscriber, Callable[[bytes], None]]] = []

        def listen(topic: str, kind: type, take: Callable[[_ArmTopics, bytes], None]) -> Any:
            def hear(data: bytes) -> None:
                try:
                    take(self, data)
                except struct.error as error:
                    rospy.logwarn_throttle(1.0, f"{root}/{topic}: unreadable message: {error}")

            if not bridge.lockstep:
                polled = PolledSubscriber(f"{root}/{topic}", kind)
                self._polled.append((polled, hear))
                return polled

            def callback(message: Any) -> None:
                hear(message.data)

            return rospy.Subscriber(f"{root}/{topic}", kind, callback, tcp_nodelay=True)

        # Tracks the trocar, when asked to; a topic that nobody fills must not be there.
        self.stale = round(bridge.track_stale * SECOND_NS / TICK_NS)
        self.frame = bridge_messages.text(f"{arm.name}_base")
        self.tracked = 0
        self.track: DirectPublisher | None = None
        if self.stale >= 0:
            self.track = DirectPublisher(f"{root}/rcm/track", PointVelocityStamped, patient)

        self.inputs = [
            listen("robot/servo_jv", RawJointState, bridge.on_velocity),
            listen("robot/servo_cv", RawTwist, bridge.on_twist),
        ]
        self.tool_input = listen("tool/servo_jp", RawJointState, bridge.on_jaw)

    def take_commands(self) -> tuple[int, ArmCommand]:
        """What has arrived since the last tick, with the stamp of the robot command [ns]."""
        for polled, hear in self._polled:
            for data in polled.fetch():
                hear(data)
        velocity = twist = None
        robot, tool = self.arrived["robot"].take(), self.arrived["tool"].take()
        if robot is not None:
            self.last_command_ns, velocity, twist = robot
            self.command = "joint_velocity" if twist is None else "cartesian_velocity"
        jaw = None if tool is None else tool[1]
        return self.last_command_ns, ArmCommand(velocity, twist, jaw)

    @property
    def controllers(self) -> set[str]:
        """The node that answers: a command to the robot and one to the tool in each tick."""
        robot = set().union(*(speakers(subscriber) for subscriber in self.inputs))
        return robot & speakers(self.tool_input)

    def release(self) -> None:
        """No tick will follow: no sender of commands waits for one."""
        for polled, _ in self._polled:
            polled.release()

    def unconnected(self) -> list[str]:
        """Sentences about what the controller is not connected to yet."""
        root = f"/{self.name}"
        missing = []
        if not any(speakers(subscriber) for subscriber in self.inputs):
            missing.append(f"nobody publishes {root}/robot/servo_jv or servo_cv (the controller)")
        if not speakers(self.tool_input):
            missing.append(f"nobody publishes {root}/tool/servo_jp (the controller)")
        controllers = self.controllers
        outputs = {"robot/measured_js": self.state, "tool/measured_js": self.tool}
        if self.track is not None:
            outputs["rcm/track"] = self.track
        for topic, output in outputs.items():
            if not output.listeners & controllers:
                hint = ", with ~track_rcm" if output is self.track else ""
                missing.append(f"the controller does not subscribe {root}/{topic}{hint}")
        return missing


class Bridge:
    """Wires the world to the graph.

    Args:
        settings: The node's parameters.
        cell: The loaded cell.
        world: Its world.
        injector: The faults between world and links.
    """

    def __init__(
        self,
        settings: BridgeSettings,
        cell: surg_core.Cell,
        world: World,
        injector: Injector,
    ) -> None:
        self._settings, self._world, self._injector = settings, world, injector
        self.lockstep = settings.mode == "lockstep"
        self.track_stale = settings.track_stale
        self._lock = threading.Lock()
        self._book = Lockstep(
            world.arms,
            settings.participants,
            {name: OBSERVER_WINDOWS[name] for name in settings.observers},
            republish=settings.abort_timeout / 5,
            abort=settings.abort_timeout,
            strict=world.task is not None,
        )
        self._deterministic = self.lockstep
        self._done = False
        self._aborted: str | None = None
        self._start_ns = 0
        self._stamp_ns = 0  # of the state that is out
        self._overruns = 0
        self._clock = DirectPublisher("/clock", Clock, self.lockstep)
        self._exposures = ExposureSchedule(wait_for_renderer=not self.lockstep)
        self._snapshot = rospy.Publisher(
            "/sim/snapshot", SimSnapshot, queue_size=0 if self.lockstep else 2, tcp_nodelay=True
        )
        self._status = rospy.Publisher("/sim/status", SimStatus, queue_size=10, latch=True)
        self._ready = rospy.Subscriber("/sim/ready", Ready, self._on_ready, tcp_nodelay=True)
        rospy.Subscriber("/sim/undeclared", String, self._on_undeclared)
        # In lock-step a tracker takes part as any sender of commands does, under this node's name.
        self._name = rospy.get_name().lstrip("/")
        self._tracker: rospy.Publisher | None = None
        if self.lockstep and settings.track_stale >= 0:
            self._tracker = rospy.Publisher("/sim/ready", Ready, queue_size=0, tcp_nodelay=True)
        if settings.inject:
            rospy.Subscriber("/sim/inject", String, self._on_inject)
        self._guided: dict[str, HandGuiding] = {}
        rospy.Subscriber("/sim/by_hand", String, self._on_by_hand)
        self._arms = [_ArmTopics(self, cell.arms[name]) for name in world.arms]
        self._task = None if world.task is None else TaskTopics(self, world, settings.setting)
        # After the task's: who is connected here can know whether there is a task.
        self._truth = DirectPublisher("/sim/ground_truth/state", GroundTruth, self.lockstep)

    # --- what arrives -----------------------------------------------------------------------

    def on_velocity(self, arm: _ArmTopics, data: bytes) -> None:
        """``robot/servo_jv``."""
        stamp_ns, _, velocity = bridge_messages.unpack_joint_state(data)
        self._take(arm, "robot", (stamp_ns, velocity, None))

    def on_twist(self, arm: _ArmTopics, data: bytes) -> None:
        """``robot/servo_cv``."""
        stamp_ns, twist = bridge_messages.unpack_twist(data)
        self._take(arm, "robot", (stamp_ns, None, twist))

    def on_jaw(self, arm: _ArmTopics, data: bytes) -> None:
        """``tool/servo_jp``."""
        stamp_ns, position, _ = bridge_messages.unpack_joint_state(data)
        self._take(arm, "tool", (stamp_ns, float(position[0]) if len(position) else None, None))

    def _take(self, arm: _ArmTopics, link: str, arrived: _Arrived) -> None:
        """In lock-step only the first answer to the present tick counts."""
        if not self.lockstep:
            arm.arrived[link].put(arrived)  # without the lock: newest.py says why
            return
        tick, rest = divmod(arrived[0], TICK_NS)
        with self._lock:
            if rest == 0 and self._book.answer(arm.name, link, tick):
                arm.arrived[link].put(arrived)
                self._advance()

    def on_assistant(
        self, assistant: AssistantTopics, sender: str, stamp_ns: int, what: str, value: Any
    ) -> None:
        """``/assistant/servo_jp``, ``/assistant/jaw/servo_jp``; None: unusable."""
        if not self.lockstep:
            if value is not None:
                assistant.keep(0, sender, what, value)
            return
        with self._lock:
            declared = self._book.declared(sender)
            if not declared:
                self._deterministic = False
            if value is not None:
                assistant.keep(stamp_ns // TICK_NS if declared else 0, sender, what, value)
            self._book.received(sender)
            self._advance()

    def _on_ready(self, message: Ready) -> None:
        if message.participant == RENDERER:
            self._exposures.rendered(message.tick)
        if not self.lockstep:
            return  # nobody is waited for, and the lock is the tick's own: newest.py says why
        with self._lock:
            sent = dict(zip(message.arms, message.sent, strict=False)).get("assistant", 0)
            self._book.ready(message.participant, message.tick, message.done, sent)
            self._advance()

    def _on_undeclared(self, message: String) -> None:
        if self._deterministic:
            rospy.logwarn(f"'{message.data}' is not a declared participant: not deterministic")
        self._deterministic = False

    def _on_inject(self, message: String) -> None:
        """Faults as JSON; what is wrong with them is said in the log and changes nothing."""
        with self._lock:
            try:
                for fault in faults.parse(message.data, self._world.arms):
                    if self.lockstep and fault.at <= self._world.tick:
                        self._deterministic = False  # it begins when the message happens to come
                    self._injector.add(fault)
                    rospy.logwarn(f"fault on purpose: {fault}")
            except faults.FaultError as error:
                rospy.logerr(f"/sim/inject: {error}")
            self._publish_status()

    def _on_by_hand(self, message: String) -> None:
        """Somebody leads an arm home by hand."""
        name = message.data
        if self.lockstep or name not in self._world.arms:
            rospy.logwarn(
                f"/sim/by_hand: '{name}' is not led by hand; allowed is one of "
                f"{', '.join(self._world.arms)}, in real time (~mode freerun)"
            )
            return
        rospy.loginfo(f"{name} is led home by hand")
        self._guided[name] = HandGuiding(self._world.cell.arms[name].robot.home)

    # --- what goes out ----------------------------------------------------------------------

    def _advance(self) -> None:
        """Lock-step, with the lock held: execute the tick if everything for it is here."""
        if self._done or self._aborted or not self._book.may_step():
            return
        last = self._book.finished()
        try:
            if self._step() or last:
                self._end()
                return
            self._publish_state(self._world.tick * TICK_NS)
        except Exception as error:  # a task may be anybody's code: its mistake ends the run by name
            rospy.logerr(traceback.format_exc())
            self._aborted = f"tick {self._world.tick}: {type(error).__name__}: {error}"
            return
        self._open_tick()

    def _open_tick(self) -> None:
        """Wait for the answers to the state that is out; a lost tool link cannot have one."""
        self._book.publish(self._world.tick, time.monotonic())
        for arm in self._arms:
            if self._injector.tool_lost(arm.name):
                self._book.answer(arm.name, "tool", self._world.tick)

    def _step(self) -> bool:
        """Execute the present tick; returns whether the task's episode ends with it."""
        arrived = {arm.name: arm.take_commands() for arm in self._arms}
        commands = self._led(self._injector.commands(arrived))
        if self._task is None:
            self._world.step(commands)
            return False
        tick = self._world.tick
        self._task.publish_forces(tick, self._stamp_ns)
        over = self._task.verdict.done and (self.lockstep or not self._settings.endless)
        self._world.step(commands, self._task.take(tick))
        return over or self._task.distrust()

    def _led(self, commands: Mapping[str, ArmCommand]) -> Mapping[str, ArmCommand]:
        """With the pushes of hands on arms that their controllers leave alone."""
        for name, hand in tuple(self._guided.items()):
            led = hand.guide(self._world.state(name).q, commands.get(name, ArmCommand()))
            if led is None:
                del self._guided[name]
                rospy.loginfo(f"{name}: the hand has let go")
            else:
                commands = {**commands, name: led}
        return commands

    def _end(self) -> None:
        """The last tick has been executed; with the lock held."""
        self._done = True
        self._publish_status()

    def _publish_state(self, stamp_ns: int) -> None:
        tick, world = self._world.tick, self._world
        self._stamp_ns = stamp_ns
        if self._clock.connections:
            self._clock.send(struct.pack("<2I", *divmod(stamp_ns, SECOND_NS)))
        for arm in self._arms:
            self._publish_links(arm, tick, stamp_ns)
        if self._task is not None:
            self._task.publish(tick, stamp_ns)
        if self._truth.connections:
            truths = ((arm.name, world.truth(arm.name)) for arm in self._arms)
            self._truth.send(bridge_messages.pack_ground_truth(stamp_ns, tick, truths))
        if self._exposures.due(tick):
            snapshot = SimSnapshot(tick=tick, qpos=world.data.qpos.tolist())
            snapshot.header.stamp = rospy.Time(*divmod(stamp_ns, SECOND_NS))
            self._snapshot.publish(snapshot)
        if self._tracker is not None:
            arms, sent = [arm.name for arm in self._arms], [arm.tracked for arm in self._arms]
            self._tracker.publish(Ready(tick=tick, participant=self._name, arms=arms, sent=sent))
        # The joint states go last: their arrival starts the controller's work.
        for arm in self._arms:
            for stamp, state in self._injector.states(arm.name, stamp_ns):
                arm.state.send(arm.layout.pack(tick, stamp, state.q, state.qd))

    def _publish_links(self, arm: _ArmTopics, tick: int, stamp_ns: int) -> None:
        """Jaw, status and tracker of one arm."""
        injector, link = self._injector, self._world.link(arm.name)
        jaw = injector.jaw(arm.name) if tick % arm.tool_ticks == 0 else None
        if jaw is not None:
            arm.tool.send(_JAW.pack(tick, stamp_ns, _one(jaw[0]), _one(jaw[1])))
        if arm.status.connections and injector.speaks(arm.name):
            arm.status.send(
                bridge_messages.pack_link_status(
                    stamp_ns,
                    tick,
                    arm.command,
                    arm.last_command_ns,
                    link.dead_man,
                    self.lockstep,
                    link.fault,
                )
            )
        seen = None if arm.track is None else injector.track(arm.name, arm.stale)
        if arm.track is not None and seen is not None:
            when, point, velocity = seen
            stamp_seen = stamp_ns - (tick - when) * TICK_NS
            arm.tracked += 1
            arm.track.send(
                bridge_messages.pack_point_velocity(stamp_seen, tick, arm.frame, point, velocity)
            )

    def _publish_status(self) -> None:
        # At the end the last executed tick counts; while running, the one whose state is out.
        tick = self._world.tick - int(self._done)
        state = SimStatus.STATE_RUNNING
        if self._done or self._aborted:
            state = SimStatus.STATE_ABORTED if self._aborted else SimStatus.STATE_DONE
        message = SimStatus(
            version=SimStatus.VERSION,
            state=state,
            mode=SimStatus.MODE_LOCKSTEP if self.lockstep else SimStatus.MODE_FREERUN,
            detail=self._aborted or "",
            tick=tick,
            sim_time=tick * TICK_NS / SECOND_NS,
            deterministic=self._deterministic,
            state_hash=self._world.hash if self.lockstep else "",
            overruns=self._overruns,
            faults=self._injector.active,
            task=self._task.status() if self._task else TaskStatus(state=TaskStatus.STATE_NONE),
        )
        message.header.stamp = rospy.Time(*divmod(time.time_ns(), SECOND_NS))
        self._status.publish(message)

    # --- the two modes ----------------------------------------------------------------------

    def run(self, view: Callable[[], None]) -> int:
        """Serve until shutdown.

        Args:
            view: Called with the lock held a few times a second; shows the world.

        Returns:
            Exit code: 1 after an aborted lock-step run, else 0.
        """
        work = self._watch_lockstep if self.lockstep else self._free_run
        worker = threading.Thread(target=work, daemon=True)
        worker.start()
        due = 0.0
        while not rospy.is_shutdown() and not self._aborted:
            with self._lock:
                view()
                if time.monotonic() >= due:
                    due = time.monotonic() + _STATUS_PERIOD
                    self._publish_status()
            time.sleep(0.04)
        worker.join(1.0)
        if self._aborted:
            with self._lock:
                self._publish_status()
            print(f"surg_sim: lock-step aborted: {self._aborted}", file=sys.stderr, flush=True)
            time.sleep(0.5)  # let the last status reach its subscribers
        return 1 if self._aborted else 0

    def _unconnected(self) -> list[str]:
        missing = [sentence for arm in self._arms for sentence in arm.unconnected()]
        controllers = {arm.name: arm.controllers for arm in self._arms}
        missing += [] if self._task is None else self._task.unconnected(controllers)
        ready = speakers(self._ready) - {rospy.get_name()}
        names = [*self._settings.participants, *self._settings.observers]
        if len(ready) < len(names):
            missing.append(f"{len(ready)} of {len(names)} ({', '.join(names)}) publish /sim/ready")
        if self._tracker is not None:
            heard = listeners(self._tracker)
            missing += [
                f"the controller of {name} does not subscribe /sim/ready"
                for name, nodes in controllers.items()
                if not heard & nodes
            ]
        if "recorder" in self._settings.observers and not self._truth.listeners & ready:
            missing.append("the recorder does not subscribe /sim/ground_truth/state")
        if "endoscope" in self._settings.observers and not listeners(self._snapshot) & ready:
            missing.append("the endoscope does not subscribe /sim/snapshot")
        return missing

    def _watch_lockstep(self) -> None:
        """Start when everybody is connected; then ask again or give up when nothing comes."""
        give_up = time.monotonic() + self._settings.connect_timeout
        while (missing := self._unconnected()) and not rospy.is_shutdown():
            if time.monotonic() > give_up:
                self._aborted = f"not everybody connected: {'; '.join(missing)}"
                return
            time.sleep(0.02)
        with self._lock:
            self._publish_state(self._world.tick * TICK_NS)
            self._open_tick()
        while not rospy.is_shutdown() and not self._done:
            time.sleep(0.1)
            with self._lock:
                action = Action.WAIT if self._done else self._book.poll(time.monotonic())
                if action is Action.REPUBLISH:
                    self._publish_state(self._world.tick * TICK_NS)
                elif action is Action.ABORT:
                    self._aborted = "; ".join(self._book.missing()) or "nothing happened"
                    return

    def _free_run(self) -> None:
        """500 Hz by the steady clock; stamps are start + k * 2 ms of wall time."""
        self._start_ns = time.time_ns() - self._world.tick * TICK_NS
        deadline = time.monotonic()
        period = TICK_NS / SECOND_NS
        while not rospy.is_shutdown():
            deadline += period
            left = deadline - time.monotonic()
            if left > 0:
                time.sleep(left)
            elif left < -_LATE:
                # The machine stood still: drop the backlog, in time and in stamps.
                self._overruns += 1
                deadline -= left
                self._start_ns -= int(left * SECOND_NS)
            with self._lock:
                if self._step():
                    self._end()
                    for arm in self._arms:
                        arm.release()
                    return
                self._publish_state(self._start_ns + self._world.tick * TICK_NS)


_JAW = bridge_messages.JointStateLayout(["jaw"])


def _one(value: float) -> Any:
    return bridge_messages.np.array([value])


def _viewer(world: World) -> Callable[[], None]:
    """Opens a passive viewer and returns what refreshes it; says so where there is no display."""
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        rospy.logwarn("~view: this session has no display (DISPLAY is not set): no viewer window")
        return lambda: None
    import mujoco.viewer

    viewer = mujoco.viewer.launch_passive(world.model, world.data, show_left_ui=False)
    return lambda: viewer.sync() if viewer.is_running() else None


def _only_here(settings: BridgeSettings) -> None:
    """Refuse faults on purpose where somebody else's machine could send them."""
    host = urlparse(os.environ.get("ROS_MASTER_URI", "")).hostname or ""
    here = host == "localhost" or host.startswith("127.")
    if (settings.inject or settings.faults) and not here:
        raise ValueError(
            f"parameters ~inject and ~faults need a ROS master on this machine's loopback "
            f"(localhost or 127.x.x.x); ROS_MASTER_URI names {host!r}"
        )


def main() -> int:
    """Entry point; returns the exit code (0 done, 1 aborted, 2 broken configuration)."""
    rospy.init_node("sim")
    # MuJoCo's own way is a file in whatever folder the node was started from.
    mujoco.set_mju_user_warning(lambda text: rospy.logwarn(f"MuJoCo: {text}"))
    try:
        settings = read(BridgeSettings, rospy.get_param("~", {}))
        _only_here(settings)
        cell = surg_core.load_cell(settings.cell)
        known = faults.parse(settings.faults, settings.arms or tuple(cell.arms))
        world = World(
            cell,
            settings.seed,
            looks=settings.view,
            arms=settings.arms,
            tool_errors=tool_errors(known, settings.seed) or None,
            setting=patient_settings.find_setting(settings.setting) if settings.setting else None,
            task=tasks.load(settings.task) if settings.task else None,
        )
        injector = Injector(world, known, settings.seed, settings.mode == "lockstep")
    except (ValueError, OSError) as error:
        print(f"surg_sim: {error}", file=sys.stderr, flush=True)
        return 2
    # Hand the interpreter over quickly: answers arrive on threads of their own.
    sys.setswitchinterval(1e-4)
    bridge = Bridge(settings, cell, world, injector)
    return bridge.run(_viewer(world) if settings.view else lambda: None)


if __name__ == "__main__":
    sys.exit(main())
