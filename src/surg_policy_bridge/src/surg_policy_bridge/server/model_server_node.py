"""The model server as a node: policies on one side, the arms on the other.

Parameters: ``~bind`` (tcp://127.0.0.1:5555), ``~keys`` (folder of ./surg keys), ``~cell``,
``~arms`` ([PSM1]), ``~mode`` (freerun | lockstep), ``~task``, ``~instruction``, ``~privileged``
(false: the simulator's truth is not served), ``~cameras`` ([]), ``~camera_rate`` (20), ``~clip``
([jaw]), ``~autostart`` (false), ``~need_teleop`` (true: no policy runs without the status of a
teleoperation node), ``~need_present`` (false), ``~answer_timeout`` (5 s). Exit code 2: a parameter
or file that must not be used.
"""

from __future__ import annotations

import contextlib
import math
import os
import secrets
import signal
import sys
import threading
import time
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rosgraph
import rospy
import zmq
from sensor_msgs.msg import Image, Joy
from std_msgs.msg import Bool

import surg_core
from surg_core.arm_view import ArmCommands, ArmView
from surg_core.contract import (
    ARM_ACTION,
    GRID,
    SECOND_NS,
    STATE_KEY,
    TASK_STATE_KEY,
    TICK_NS,
    image_key,
)
from surg_core.status_check import Newest
from surg_msgs.msg import PolicyAction, PolicyStatus, TeleopStatus
from surg_policy_bridge.server import cell_spec, operator_first
from surg_policy_bridge.server.listen_address import BindError
from surg_policy_bridge.server.model_server import ModelServer, ServerSettings, State
from surg_policy_bridge.server.observer import (
    TOLERANCE,
    CameraWatch,
    Observation,
    Observer,
    lagging_arm,
)
from surg_policy_bridge.server.policy_arm import arm_state
from surg_policy_bridge.server.policy_status_node import policy_status
from surg_policy_bridge.server.router_node import Router
from surg_policy_bridge.server.safety_controller import ArmLimits, SafetyController
from surg_policy_bridge.server.server_parameters import Settings
from surg_policy_bridge.server.step_clock import StepClock
from surg_policy_bridge.server.stop_reason import StopReason
from surg_policy_bridge.server.timers import CAMERA_PERIODS, OperatorPresence
from surg_policy_bridge.server.wire_endpoint import WireEndpoint
from surg_policy_client.errors import BadKeys
from surg_policy_client.keys import ServerKeys, server_keys
from surg_ros.arm_port import ArmPort, arm_view
from surg_ros.camera_topic import camera_topic
from surg_ros.params import ParamError, read
from surg_ros.participant import Participant, Seen
from surg_ros.transport.raw_message import RawCycle, RawTaskState

COMMANDS = ("state_command", "authority/claim", "hold", "jaw/servo_jp", "servo_cp")
"""Topics of an arm that the server publishes."""
FRESH = SECOND_NS // 4
"""[ns] Free-run: an arm that has said nothing for longer is silent. (Its controller has a watchdog
of its own for the link behind it; an observation is as old as the cycle in it.)"""
PATIENCE = 8 * SECOND_NS
"""[ns] Lock-step: longest wait for a picture of the tick; the simulator gives up after 10 s."""
NICE = 5
"""A message may come late, a control cycle may not: who floods the port keeps this process busy."""
AUTOGROUP = Path("/proc/self/autogroup")
"""Linux shares the processor among sessions, and ./surg gives every node one of its own: a node's
niceness only counts among its own threads, that of its session counts among nodes."""
REPORT = SECOND_NS // 2
"""[ns] The status is published at least that often."""
ENCODINGS = {"rgb8": slice(None), "bgr8": slice(None, None, -1)}


class ModelServerNode:
    """Wires socket and topics; every decision is `ModelServer`'s.

    Args:
        settings: The node's parameters.
        cell: The cell.
        keys: Of the server; None: this machine only.
    """

    def __init__(self, settings: Settings, cell: surg_core.Cell, keys: ServerKeys | None) -> None:
        self._settings, self._cell = settings, cell
        self._lock = threading.RLock()
        self.finished = threading.Event()
        """Set where the node shall end."""
        self._wake = os.eventfd(0, os.EFD_NONBLOCK)
        self._router = Router(settings.bind, keys)
        self._poller = zmq.Poller()
        self._poller.register(self._router.socket, zmq.POLLIN)
        self._poller.register(self._wake, zmq.POLLIN)
        limits = {name: ArmLimits.of(cell.arms[name]) for name in settings.arms}
        answer = round(settings.answer_timeout * SECOND_NS)
        more: dict[str, int] = {"silence": answer} if settings.lockstep else {}
        self._server = ModelServer(
            ServerSettings(
                arms=settings.arms,
                node=rospy.get_name(),
                instruction=settings.instruction,
                autostart=settings.autostart,
                **more,
            ),
            SafetyController(limits, settings.clip),
            lambda: secrets.randbits(64) or 1,
        )
        self._endpoint = WireEndpoint(self._server)
        self._clock = StepClock(settings.arms, time.monotonic_ns())
        keys_seen = [STATE_KEY, *map(image_key, settings.cameras)]
        keys_seen += [TASK_STATE_KEY] if settings.privileged else []
        period = round(SECOND_NS / settings.camera_rate)
        tolerance = max(TOLERANCE, CAMERA_PERIODS * period if settings.cameras else 0)
        self._observer = Observer(keys_seen, 0 if settings.lockstep else tolerance)
        self._watches = {name: CameraWatch(name, period) for name in settings.cameras}
        # Of the simulator: pictures without noise.
        self._drawn = all(cell.arms[name].link == "simulator" for name in settings.arms)
        self._sizes: dict[str, tuple[int, int]] = {}
        self._numbers: list[str] | None = None
        self._serving = False
        self._cycles: dict[str, tuple[int, RawCycle]] = {}
        self._due: int | None = None
        self._over = False
        self._teleop = Newest("/teleop/status")
        self._homed = False
        self._presence = OperatorPresence()
        self._refused = ""
        self._reported = -REPORT
        self._said: tuple[object, ...] = ()
        self._ports = {name: ArmPort(name, COMMANDS) for name in settings.arms}
        self._advertise()
        self._participant = self._join_lockstep() if settings.lockstep else None
        inputs = self._subscribe()
        if self._participant is not None:
            self._participant.inputs += inputs
        self._begin_serving()

    # --- topics -----------------------------------------------------------------------------------

    def _advertise(self) -> None:
        out = rospy.Publisher
        self._action = out("/policy/action", PolicyAction, queue_size=0, tcp_nodelay=True)
        self._rejected = out("/policy/rejected", PolicyAction, queue_size=0, tcp_nodelay=True)
        self._enabled = out("/policy/enabled", Bool, queue_size=2, latch=True)
        self._status = out("/policy/status", PolicyStatus, queue_size=2, latch=True)

    def _join_lockstep(self) -> Participant:
        """A participant that is told of messages by this node, which needs them too."""
        return Participant(
            self._ports,
            self._on_tick,
            self._settings.arms,
            task=bool(self._settings.task),
            listen=False,
            lock=self._lock,
        )

    def _subscribe(self) -> list[rospy.Subscriber]:
        settings = self._settings

        def listen(topic: str, kind: type, callback: Any, *arguments: Any) -> rospy.Subscriber:
            keys: dict[str, Any] = {"queue_size": None, "tcp_nodelay": True}
            return rospy.Subscriber(topic, kind, callback, *arguments, **keys)

        found = [listen(f"/{arm}/cycle", RawCycle, self._on_cycle, arm) for arm in settings.arms]
        if settings.task or settings.privileged:
            found.append(listen("/sim/task_state", RawTaskState, self._on_task_state))
        for camera in settings.cameras:
            keys: dict[str, Any] = {"queue_size": 2, "buff_size": 1 << 24, "tcp_nodelay": True}
            topic = camera_topic(camera)[1]
            found.append(rospy.Subscriber(topic, Image, self._on_image, camera, **keys))
        listen("/policy/enable", Bool, self._on_enable)
        listen("/teleop/status", TeleopStatus, self._on_teleop)
        if settings.need_present:
            for source in ("/console", "/footpedals"):
                listen(f"{source}/operator_present", Joy, self._on_present, source)
        return found

    def _on_cycle(self, message: RawCycle, arm: str) -> None:
        with self._lock:
            self._cycles[arm] = (time.monotonic_ns(), message)
            if self._participant is not None:
                self._participant.on_cycle(message, arm)

    def _on_task_state(self, message: RawTaskState) -> None:
        with self._lock:
            tick = message.tick()
            if self._settings.privileged and tick % GRID == 0:
                state = message.read()
                values = np.array(state.values, dtype="<f4")
                self._observer.put(TASK_STATE_KEY, state.header.stamp.to_nsec(), values)
                if self._numbers is None:
                    self._numbers = cell_spec.task_numbers(state.names)
                    self._begin_serving()
            self._look_for_the_end(message)
            if self._participant is not None:
                self._participant.on_task(message)

    def _look_for_the_end(self, message: RawTaskState) -> None:
        state = message.read()
        if state.done and not self._over:
            self._server.episode_over(bool(state.success), state.reason)
            self._rouse()
        self._over = bool(state.done)

    def _on_image(self, message: Image, camera: str) -> None:
        order = ENCODINGS.get(message.encoding)
        if order is None or message.step != 3 * message.width:
            rospy.logwarn_throttle(
                5.0, f"{camera}: encoding {message.encoding}: rgb8 or bgr8 is needed"
            )
            return
        if problem := cell_spec.too_large(message.height, message.width):
            rospy.logwarn_throttle(5.0, f"{camera}: {problem}")
            return
        pixels = np.frombuffer(message.data, np.uint8)
        picture = pixels.reshape(message.height, message.width, 3)[:, :, order]
        stamp_ns, fingerprint = message.header.stamp.to_nsec(), zlib.crc32(message.data)
        with self._lock:
            self._watches[camera].picture(time.monotonic_ns(), stamp_ns, fingerprint)
            size = (message.height, message.width)
            if self._sizes.setdefault(camera, size) != size:
                rospy.logwarn_throttle(5.0, f"{camera}: size {size} is not {self._sizes[camera]}")
                return
            key = image_key(camera)
            self._observer.put(key, stamp_ns, np.ascontiguousarray(picture))
            self._begin_serving()
            if self._due is not None:
                self._rouse()

    def _on_enable(self, message: Bool) -> None:
        with self._lock:
            self._refused = self._server.enable(bool(message.data), self._now())
            if self._refused:
                rospy.logwarn("the policy is not enabled: %s", self._refused)
            self._reported = -REPORT
            self._rouse()

    def _on_teleop(self, message: TeleopStatus) -> None:
        with self._lock:
            self._teleop.take(message, time.monotonic())
            self._rouse()

    def _on_present(self, message: Joy, source: str) -> None:
        with self._lock:
            down = bool(message.buttons) and message.buttons[0] == 1
            self._presence.press(source, down, time.monotonic_ns())
            self._rouse()

    def _rouse(self) -> None:
        os.eventfd_write(self._wake, 1)

    # --- what is served ---------------------------------------------------------------------------

    def _begin_serving(self) -> None:
        """Serve as soon as everything that the specification names is known."""
        settings = self._settings
        numbers_known = self._numbers is not None or not settings.privileged
        if self._serving or len(self._sizes) < len(settings.cameras) or not numbers_known:
            return
        self._serving = True
        sizes = {name: self._sizes[name] for name in settings.cameras}
        arms, task, cell = settings.arms, settings.task, self._cell
        spec = cell_spec.make(cell, arms, task, sizes, self._numbers)
        self._server.serve(spec, time.monotonic_ns())
        self._rouse()

    def _refusal(self) -> operator_first.Refusal:
        """Why the policy may not have the arms now."""
        settings, now = self._settings, time.monotonic()
        present = not settings.need_present or self._presence.detected(time.monotonic_ns())
        found = operator_first.refusal(
            settings.arms, self._teleop, now, settings.need_teleop, present
        )
        if found[0] is StopReason.TELEOP_STATUS and (complaint := self._teleop.complaint(now)):
            rospy.logwarn("no arm is given to a policy: %s", complaint)
        return found

    def _blind(self, now: int, views: dict[str, ArmView]) -> str:
        """Which camera no policy may look at now; in lock-step its picture is waited for."""
        place = None
        if self._drawn and views:
            place = np.concatenate([view.p_tip for view in views.values()])
        before, self._homed = self._homed, all(view.homed for view in views.values())
        for watch in self._watches.values():
            if not (before and self._homed):  # the tips were not yet said in the frame of now
                watch.forget_tips()
            if problem := watch.problem(now, place):
                return problem
        return ""

    def _now(self) -> int:
        """Time of the execution [ns]."""
        return self._participant.tick * TICK_NS if self._participant else time.monotonic_ns()

    def _put_state(self, views: dict[str, ArmView]) -> tuple[int | None, str]:
        """Observe the arms; the stamp of the youngest, or None and why not."""
        if len(views) < len(self._ports):
            return None, "an arm is silent"
        if why := lagging_arm({arm: view.stamp_ns for arm, view in views.items()}):
            return None, why
        numbers = np.array([n for arm in self._ports for n in arm_state(views[arm])], dtype="<f4")
        if not np.isfinite(numbers).all():
            return None, "an arm does not know its jaw"
        stamp_ns = max(view.stamp_ns for view in views.values())
        self._observer.put(STATE_KEY, stamp_ns, numbers)
        return stamp_ns, ""

    # --- real time --------------------------------------------------------------------------------

    def run(self) -> None:
        """Serve until ``finished``."""
        if self._settings.lockstep:
            threading.Thread(target=self._connect, daemon=True).start()
        while not self.finished.is_set() and not rospy.is_shutdown():
            self._wait(self._clock.due(time.monotonic_ns()))
            with self._lock:
                self._listen()
                if self._settings.lockstep:
                    self._grid_tick()
                else:
                    self._beat(time.monotonic_ns())
                self._tell(time.monotonic_ns())

    def _wait(self, due: int) -> None:
        """Until a message, a callback or a time."""
        left = max(0, due - time.monotonic_ns())
        ready = dict(self._poller.poll(100 if self._settings.lockstep else left // 1_000_000 + 1))
        if self._wake in ready:
            os.eventfd_read(self._wake)

    def _listen(self) -> None:
        """Take what has come and answer it."""
        for peer, parts in self._router.receive():
            self._endpoint.receive(peer, parts, time.monotonic_ns())
        self._answer()

    def _answer(self) -> None:
        for peer, parts in self._endpoint.take_frames():
            self._router.send(peer, parts)

    def _beat(self, now: int) -> None:
        """Free-run: look, observe, send."""
        views = {
            arm: arm_view(raw.read())
            for arm, (at, raw) in self._cycles.items()
            if now - at <= FRESH
        }
        cause, obstacle = self._refusal()
        commands = self._server.tick(views, now, now, obstacle, self._blind(now, views), cause)
        step = self._clock.observe(now)
        if step is not None:
            (stamp_ns, why), wanted = self._put_state(views), self._server.wanted
            seen = None if stamp_ns is None else self._observer.take(step, stamp_ns, wanted)
            if seen is not None:
                # As old as the oldest cycle or picture in it.
                oldest = min(at for at, _ in self._cycles.values()) - seen.behind
                self._server.observe(seen, oldest, now)
            else:
                missing = "" if stamp_ns is None else self._observer.missing(stamp_ns, wanted)
                self._server.observe_nothing(why or missing)
        for arm, target in self._clock.play(self._server, views, now).items():
            commands[arm] = target.commands()
        self._send(commands, views)
        self._publish_judged(time.time_ns())
        self._answer()

    def _send(self, commands: dict[str, ArmCommands], views: dict[str, ArmView]) -> None:
        """Send; the stamp says which cycle is answered: it is meant for the next one."""
        for arm, command in commands.items():
            answered = views[arm].stamp_ns if arm in views else 0
            command.stamp_ns = answered + TICK_NS if answered else 0
            self._ports[arm].send(command)

    # --- lock-step --------------------------------------------------------------------------------

    def _connect(self) -> None:
        """Answer tick 1, which has no cycle before it, once nothing can get lost."""
        assert self._participant is not None
        with contextlib.suppress(TimeoutError):
            self._participant.connect(
                math.inf, over=lambda: bool(self.finished.is_set() or rospy.is_shutdown())
            )

    def _on_tick(self, seen: Seen) -> bool | None:
        """All cycles of a tick are here; a tick of the grid is answered by `_grid_tick`."""
        if seen.tick % GRID:
            return False
        self._due = seen.tick
        self._rouse()
        return None

    def _grid_tick(self) -> None:
        """Lock-step: observe, wait for the answer, execute, and let the tick go."""
        if self._due is None or self._participant is None:
            return
        tick, self._due = self._due, None
        at, number = tick * TICK_NS, tick // GRID
        # In every state: what is served, and so when a policy begins, shall not depend on the time
        # that a picture takes.
        self._await(at, [image_key(camera) for camera in self._settings.cameras])
        views = {arm: arm_view(raw.read()) for arm, (_, raw) in self._cycles.items()}
        cause, obstacle = self._refusal()
        commands = self._server.tick(views, at, time.monotonic_ns(), obstacle, cause=cause)
        if self._server.state is State.RUNNING:
            seen = self._complete(views, number)
            if seen is not None:
                self._server.observe(seen, at, time.monotonic_ns())
                self._answer()
            self._await_answer()
            for arm, target in self._server.execute(number + 1, at).items():
                commands[arm] = target.commands()
        self._send(commands, views)
        self._publish_judged(at + TICK_NS)
        self._answer()
        self._participant.ready()

    def _complete(self, views: dict[str, ArmView], number: int) -> Observation | None:
        """The observation of a tick; parts of it may still be on their way."""
        (stamp_ns, why), wanted = self._put_state(views), self._server.wanted
        if stamp_ns is None:
            self._server.observe_nothing(why)
            return None
        self._await(stamp_ns, wanted)
        if missing := self._observer.missing(stamp_ns, wanted):
            self._server.observe_nothing(missing)
            return None
        return self._observer.take(number, stamp_ns, wanted)

    def _await(self, stamp_ns: int, keys: Sequence[str]) -> None:
        """Wait for what is observed under keys, of one stamp; a policy's pings are answered."""
        deadline = time.monotonic_ns() + PATIENCE
        while self._observer.missing(stamp_ns, keys):
            if time.monotonic_ns() > deadline or self.finished.is_set():
                return
            self._breathe()
            self._listen()

    def _await_answer(self) -> None:
        deadline = time.monotonic_ns() + round(self._settings.answer_timeout * SECOND_NS)
        while self._server.unanswered:
            if time.monotonic_ns() > deadline or self.finished.is_set():
                self._server.counters.waited += 1
                return
            self._breathe()
            self._listen()

    def _breathe(self) -> None:
        """Wait for news without the lock, which callbacks need."""
        self._lock.release()
        try:
            self._wait(0)
        finally:
            self._lock.acquire()

    # --- what people read -------------------------------------------------------------------------

    def _publish_judged(self, stamp_ns: int) -> None:
        judged, self._server.steps.judged = self._server.steps.judged, []
        names = [f"{arm}/{name}" for arm in self._ports for name in ARM_ACTION]
        for each in judged:
            message = PolicyAction(
                session=each.session,
                seq=each.seq,
                step=each.step,
                obs_age=each.obs_age / SECOND_NS,
                names=names,
                values=each.values.tolist(),
                rule=each.rule,
                text=each.text,
            )
            message.header.stamp = rospy.Time(*divmod(stamp_ns, SECOND_NS))
            (self._action if each.passed else self._rejected).publish(message)

    def _tell(self, now: int) -> None:
        server = self._server
        said = (server.state, server.reason, server.waiting, server.session is None, self._refused)
        if said == self._said and now - self._reported < REPORT:
            return
        if said[:1] != self._said[:1]:
            self._enabled.publish(Bool(server.state is State.RUNNING))
            rospy.loginfo("policy %s %s", server.state.value, server.reason)
        self._said, self._reported = said, now
        self._status.publish(policy_status(server, self._refused, self._settings.bind))

    def stop(self) -> None:
        """No exit leaves an arm moving: whoever is connected is told, what is held is paused."""
        with self._lock:
            self._server.end("the model server has ended")
            views = {arm: arm_view(raw.read()) for arm, (_, raw) in self._cycles.items()}
            now = self._now()
            commands = self._server.tick(views, now, time.monotonic_ns())
            self._send(commands, views)
            self._answer()
            self._tell(time.monotonic_ns())
            self._router.close()


def main() -> int:
    """Run the node; returns the exit code."""
    if not rosgraph.is_master_online():
        uri = rosgraph.get_master_uri()
        print(f"policy: no ROS master at {uri}; start one with './surg up CELL'", file=sys.stderr)
        return 1
    os.nice(NICE)
    with contextlib.suppress(OSError):
        AUTOGROUP.write_text(str(NICE), "ascii")
    rospy.init_node("policy", disable_signals=True)
    try:
        settings = read(Settings, rospy.get_param("~", {}))
        cell = surg_core.load_cell(settings.cell)
        settings.check_arms(list(cell.arms), [arm.link for arm in cell.arms.values()])
        keys = server_keys(settings.keys) if settings.keys else None
        node = ModelServerNode(settings, cell, keys)
    except (ParamError, surg_core.ConfigError, BadKeys, BindError, OSError) as error:
        print(f"policy: {error}", file=sys.stderr, flush=True)
        return 2
    # rospy's own handler would close the topics before the arms have been told to stop.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: node.finished.set())
    rospy.loginfo("policies connect to %s", settings.bind)
    try:
        node.run()
    finally:
        node.stop()
        rospy.signal_shutdown("policy: done")
    return 0
