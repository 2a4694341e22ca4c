"""The simulator bridge: receives commands, executes ticks, publishes states."""

from __future__ import annotations

import sys
import threading
import time
import traceback
from collections.abc import Mapping
from typing import Any

import rospy
from std_msgs.msg import Empty, String

from surg_core.contract import GRID, SECOND_NS, TICK_NS
from surg_msgs.msg import Ready, SimStatus, TaskStatus
from surg_ros.byte_topics import speakers
from surg_sim.nodes import faults
from surg_sim.nodes.arm_topics_node import ArmTopics, Arrival
from surg_sim.nodes.assistant_topics_node import AssistantTopics
from surg_sim.nodes.exposure_schedule import RENDERER, ExposureSchedule
from surg_sim.nodes.fault_injector import Injector
from surg_sim.nodes.lockstep import OBSERVER_WINDOWS, Action, Lockstep
from surg_sim.nodes.sim_parameters import BridgeSettings
from surg_sim.nodes.state_publisher_node import StatePublisher
from surg_sim.nodes.task_topics_node import TaskTopics
from surg_sim.nodes.tick_clock import TickClock
from surg_sim.physics.hand_guiding import guided_home
from surg_sim.physics.sim_arm import ArmCommand
from surg_sim.physics.world import World

_STATUS_PERIOD = 0.2  # [s] wall clock


class Bridge:
    """The world behind ROS topics.

    Lock-step: the thread that receives the last missing answer executes the tick and publishes the
    next state itself, without a timer or a hand-over. Free-run: one loop ticks at 500 Hz by the
    steady clock.
    """

    def __init__(self, settings: BridgeSettings, world: World, injector: Injector) -> None:
        self._settings, self._world, self._injector = settings, world, injector
        self.lockstep = settings.mode == "lockstep"
        self._lock = threading.Lock()
        self._lockstep_run = Lockstep(
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
        self._clock = TickClock()  # of free-run
        self._exposures = ExposureSchedule(wait_for_renderer=not self.lockstep)
        self._status = rospy.Publisher("/sim/status", SimStatus, queue_size=10, latch=True)
        self._ready = rospy.Subscriber("/sim/ready", Ready, self._on_ready, tcp_nodelay=True)
        rospy.Subscriber("/sim/undeclared", String, self._on_undeclared)
        if settings.inject:
            rospy.Subscriber("/sim/inject", String, self._on_inject)
        self._guided: set[str] = set()  # arms that a person leads home
        rospy.Subscriber("/sim/guide_home", String, self._on_guide_home)
        self._wanted = False  # free-run: another episode, at the next tick where one may begin
        rospy.Subscriber("/sim/new_episode", Empty, self._on_new_episode)
        self._arms = [
            ArmTopics(world.cell.arms[name], self.lockstep, settings.track_stale, self._on_command)
            for name in world.arms
        ]
        self._task = None if world.task is None else TaskTopics(self, world, settings)
        self._states = StatePublisher(
            world, injector, self._arms, self._task, self._exposures, self.lockstep
        )

    # --- what arrives -----------------------------------------------------------------------

    def _on_command(self, arm: ArmTopics, link: str, arrived: Arrival) -> None:
        """Keep a command; in lock-step only the first answer to the present tick counts."""
        if not self.lockstep:
            arm.arrived[link].put(arrived)  # without the lock, see command_box.py
            return
        tick, rest = divmod(arrived[0], TICK_NS)
        with self._lock:
            if rest == 0 and self._lockstep_run.answer(arm.name, link, tick):
                arm.arrived[link].put(arrived)
                self._advance()

    def on_assistant(
        self, assistant: AssistantTopics, sender: str, stamp_ns: int, what: str, value: Any
    ) -> None:
        """Take a command to the assistant's instrument; ``value`` is None if it cannot be used."""
        if not self.lockstep:
            if value is not None:
                assistant.keep(0, sender, what, value)
            return
        with self._lock:
            declared = self._lockstep_run.declared(sender)
            if not declared:
                self._deterministic = False
            if value is not None:
                assistant.keep(stamp_ns // TICK_NS if declared else 0, sender, what, value)
            self._lockstep_run.received(sender)
            self._advance()

    def _on_ready(self, message: Ready) -> None:
        if message.participant == RENDERER:
            self._exposures.rendered(message.tick)
        if not self.lockstep:
            return  # nobody is waited for; without the lock, see command_box.py
        with self._lock:
            sent = dict(zip(message.arms, message.sent, strict=False)).get("assistant", 0)
            self._lockstep_run.ready(message.participant, message.tick, message.done, sent)
            self._advance()

    def _on_undeclared(self, message: String) -> None:
        if self._deterministic:
            rospy.logwarn(f"'{message.data}' is not a declared participant: not deterministic")
        self._deterministic = False

    def _on_inject(self, message: String) -> None:
        """Add faults from JSON; an invalid one is logged and ignored."""
        with self._lock:
            try:
                for fault in faults.parse(message.data, self._world.arms):
                    if self.lockstep and fault.at <= self._world.tick:
                        self._deterministic = False  # its begin depends on when the message arrives
                    self._injector.add(fault)
                    rospy.logwarn(f"injected fault: {fault}")
            except faults.FaultError as error:
                rospy.logerr(f"/sim/inject: {error}")
            self._publish_status()

    def _on_guide_home(self, message: String) -> None:
        """Start guiding an arm home."""
        name = message.data
        if self.lockstep or name not in self._world.arms:
            rospy.logwarn(
                f"/sim/guide_home: cannot guide '{name}'; allowed are "
                f"{', '.join(self._world.arms)}, in real time only (~mode freerun)"
            )
            return
        rospy.loginfo(f"{name}: guided home by hand")
        self._guided.add(name)

    def _on_new_episode(self, _: Empty) -> None:
        """Begin another episode soon; its arms are at home at once, so controllers must be off."""
        if self.lockstep or self._task is None:
            rospy.logwarn("/sim/new_episode: needs a task, in real time (~mode freerun)")
            return
        self._wanted = True

    # --- what goes out ----------------------------------------------------------------------

    def _advance(self) -> None:
        """Lock-step, with the lock held: execute the tick if it is complete."""
        if self._done or self._aborted or not self._lockstep_run.may_step():
            return
        last = self._lockstep_run.finished()
        try:
            if self._step() or last:
                self._done = True
                self._publish_status()
                return
            self._states.publish(self._world.tick * TICK_NS)
        except Exception as error:  # a task may be user code: name its error and end the run
            rospy.logerr(traceback.format_exc())
            self._aborted = f"tick {self._world.tick}: {type(error).__name__}: {error}"
            return
        self._open_tick()

    def _open_tick(self) -> None:
        """Begin to wait for answers to the published state; a lost tool link gives none."""
        self._lockstep_run.publish(self._world.tick, time.monotonic())
        for arm in self._arms:
            if self._injector.tool_lost(arm.name):
                self._lockstep_run.answer(arm.name, "tool", self._world.tick)

    def _step(self) -> bool:
        """Execute the present tick; returns whether the episode ends with it."""
        arrived = {arm.name: arm.take_commands(self._clock.behind) for arm in self._arms}
        commands = self._guide(self._injector.commands(arrived))
        if self._task is None:
            self._world.step(commands)
            return False
        tick = self._world.tick
        self._task.publish_forces(tick, self._states.stamp_ns)
        over = self._task.verdict.done and (self.lockstep or not self._settings.endless)
        self._world.step(commands, self._task.take(tick))
        if self._wanted and self._world.tick % GRID == 1:  # as a world's first tick is
            self._wanted = False
            self._task.begin_next()
            self._guided.clear()
            rospy.loginfo(f"a new episode, seed {self._task.seed}")
        return over or self._task.distrust()

    def _guide(self, commands: Mapping[str, ArmCommand]) -> Mapping[str, ArmCommand]:
        """Replace the commands of arms that are guided by hand."""
        for name in tuple(self._guided):
            home, q = self._world.cell.arms[name].robot.home, self._world.state(name).q
            guided = guided_home(home, q, commands.get(name, ArmCommand()))
            if guided is None:
                self._guided.discard(name)
                rospy.loginfo(f"{name}: hand guiding has ended")
            else:
                commands = {**commands, name: guided}
        return commands

    def _publish_status(self) -> None:
        # While running, the tick of the published state; at the end, the last executed one.
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
            overruns=self._clock.overruns,
            faults=self._injector.active,
            task=self._task.status() if self._task else TaskStatus(state=TaskStatus.STATE_NONE),
        )
        message.header.stamp = rospy.Time(*divmod(time.time_ns(), SECOND_NS))
        self._status.publish(message)

    # --- the two modes ----------------------------------------------------------------------

    def run(self) -> int:
        """Serve until shutdown; the exit code is 1 after an aborted lock-step run, else 0."""
        work = self._watch_lockstep if self.lockstep else self._free_run
        worker = threading.Thread(target=work, daemon=True)
        worker.start()
        due = 0.0
        while not rospy.is_shutdown() and not self._aborted:
            if time.monotonic() >= due:
                due = time.monotonic() + _STATUS_PERIOD
                with self._lock:
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
        missing += self._states.unconnected(self._settings.observers, ready, controllers)
        return missing

    def _watch_lockstep(self) -> None:
        """Start once all nodes are connected; then repeat the state or abort on silence."""
        give_up = time.monotonic() + self._settings.connect_timeout
        while (missing := self._unconnected()) and not rospy.is_shutdown():
            if time.monotonic() > give_up:
                self._aborted = f"not everybody connected: {'; '.join(missing)}"
                return
            time.sleep(0.02)
        with self._lock:
            self._states.publish(self._world.tick * TICK_NS)
            self._open_tick()
        while not rospy.is_shutdown() and not self._done:
            time.sleep(0.1)
            with self._lock:
                action = Action.WAIT if self._done else self._lockstep_run.poll(time.monotonic())
                if action is Action.REPUBLISH:
                    self._states.publish(self._world.tick * TICK_NS)
                elif action is Action.ABORT:
                    self._aborted = "; ".join(self._lockstep_run.missing()) or "nothing happened"
                    return

    def _free_run(self) -> None:
        """Tick by the steady clock."""
        self._clock.begin(self._world.tick, time.monotonic(), time.time_ns())
        while not rospy.is_shutdown():
            if (left := self._clock.next(time.monotonic())) > 0.0:
                time.sleep(left)
            with self._lock:
                if self._step():
                    self._done = True
                    self._publish_status()
                    return
                self._states.publish(self._clock.stamp_ns(self._world.tick))
