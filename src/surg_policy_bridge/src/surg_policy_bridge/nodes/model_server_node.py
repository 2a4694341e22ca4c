"""The model server as a node: connects policies to the arms.

Parameters: ``~bind`` (tcp://127.0.0.1:5555), ``~keys`` (folder of ./surg keys), ``~cell``,
``~arms`` ([PSM1]), ``~mode`` (freerun | lockstep), ``~task``, ``~instruction``, ``~privileged``
(false: do not serve ground truth), ``~cameras`` ([]), ``~camera_rate`` (20), ``~clip``
([jaw]), ``~autostart`` (false), ``~need_teleop`` (true: no policy runs without the status of a
teleoperation node), ``~need_present`` (false), ``~answer_timeout`` (5 s). Exit code 2: invalid
parameter or file.
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
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import rosgraph
import rospy
import zmq
from sensor_msgs.msg import Image, Joy
from std_msgs.msg import Bool

import surg_core
from surg_core.arm_view import ArmCommands, ArmView
from surg_core.contract import GRID, SECOND_NS, TICK_NS
from surg_core.status_check import Newest
from surg_msgs.msg import Cycle, TaskState, TeleopStatus
from surg_policy_bridge.server import operator_first
from surg_policy_bridge.server.listen_address import BindError
from surg_policy_bridge.server.model_server import ModelServer, ServerSettings, State
from surg_policy_bridge.server.observation_sources_node import ObservationSources
from surg_policy_bridge.server.observer import Observation
from surg_policy_bridge.server.policy_topics_node import PolicyTopics
from surg_policy_bridge.server.router_node import Router
from surg_policy_bridge.server.safety_controller import ArmLimits, SafetyController
from surg_policy_bridge.server.server_parameters import Settings
from surg_policy_bridge.server.step_clock import StepClock
from surg_policy_bridge.server.stop_reason import StopReason
from surg_policy_bridge.server.timers import OperatorPresence
from surg_policy_bridge.server.wire_endpoint import WireEndpoint
from surg_policy_client.errors import BadKeys
from surg_policy_client.keys import ServerKeys, server_keys
from surg_ros.arm_port import ArmPort, arm_view
from surg_ros.camera_topic import camera_topic
from surg_ros.params import ParamError, read
from surg_ros.participant import Participant, Seen

COMMANDS = ("state_command", "authority/claim", "hold", "jaw/servo_jp", "servo_cp")
"""Topics of an arm that the server publishes."""
FRESH = SECOND_NS // 4
"""[ns] Timeout of an arm in free-run. Its controller supervises the robot link itself."""
PATIENCE = 8 * SECOND_NS
"""[ns] Longest wait for a picture in lock-step; the simulator times out after 10 s."""
NICE = 5
"""Niceness: control cycles go before messages, also while somebody floods the port."""
AUTOGROUP = Path("/proc/self/autogroup")
"""Linux schedules by session, and ./surg gives every node its own: among nodes only the niceness of
the session counts."""


class ModelServerNode:
    """Connects socket and topics; `ModelServer` makes every decision.

    Args:
        settings: The node's parameters.
        cell: The cell.
        keys: Of the server; None: this machine only.
    """

    def __init__(self, settings: Settings, cell: surg_core.Cell, keys: ServerKeys | None) -> None:
        self._settings, self._cell = settings, cell
        self._lock = threading.RLock()
        self.finished = threading.Event()
        """Set to end the node."""
        self._wake = os.eventfd(0, os.EFD_NONBLOCK)  # type: ignore[attr-defined]
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
        self._sources = ObservationSources(settings, cell)
        self._observer = self._sources.observer
        self._serving = False
        self._cycles: dict[str, tuple[int, Cycle]] = {}
        self._due: int | None = None
        self._episode_over = False
        self._teleop = Newest("/teleop/status")
        self._presence = OperatorPresence()
        self._refused = ""
        self._ports = {name: ArmPort(name, COMMANDS) for name in settings.arms}
        self._topics = PolicyTopics(settings.arms, settings.bind)
        self._participant = self._join_lockstep() if settings.lockstep else None
        inputs = self._subscribe()
        if self._participant is not None:
            self._participant.inputs += inputs
        self._begin_serving()

    # --- topics -----------------------------------------------------------------------------------

    def _join_lockstep(self) -> Participant:
        """A participant that gets its messages from this node, which needs them too."""
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

        inputs = [listen(f"/{arm}/cycle", Cycle, self._on_cycle, arm) for arm in settings.arms]
        if settings.task or settings.privileged:
            inputs.append(listen("/sim/task_state", TaskState, self._on_task_state))
        for camera in settings.cameras:
            keys: dict[str, Any] = {"queue_size": 2, "buff_size": 1 << 24, "tcp_nodelay": True}
            topic = camera_topic(camera)[1]
            inputs.append(rospy.Subscriber(topic, Image, self._on_image, camera, **keys))
        listen("/policy/enable", Bool, self._on_enable)
        listen("/teleop/status", TeleopStatus, self._on_teleop)
        if settings.need_present:
            for source in ("/console", "/footpedals"):
                listen(f"{source}/operator_present", Joy, self._on_present, source)
        return inputs

    def _on_cycle(self, message: Cycle, arm: str) -> None:
        with self._lock:
            self._cycles[arm] = (time.monotonic_ns(), message)
            if self._participant is not None:
                self._participant.on_cycle(message, arm)

    def _on_task_state(self, message: TaskState) -> None:
        with self._lock:
            if self._settings.privileged and message.tick % GRID == 0:
                self._sources.add_task_state(message)
                self._begin_serving()
            if message.done and not self._episode_over:
                self._server.episode_over(bool(message.success), message.reason)
                self._rouse()
            self._episode_over = bool(message.done)
            if self._participant is not None:
                self._participant.on_task(message)

    def _on_image(self, message: Image, camera: str) -> None:
        with self._lock:
            self._sources.add_image(message, camera)
            self._begin_serving()
            if self._due is not None:
                self._rouse()

    def _on_enable(self, message: Bool) -> None:
        with self._lock:
            self._refused = self._server.enable(bool(message.data), self._now())
            if self._refused:
                rospy.logwarn("the policy is not enabled: %s", self._refused)
            self._topics.status_due()
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
        os.eventfd_write(self._wake, 1)  # type: ignore[attr-defined]

    # --- what is served ---------------------------------------------------------------------------

    def _begin_serving(self) -> None:
        """Serve as soon as every source has sent."""
        if self._serving or (spec := self._sources.spec()) is None:
            return
        self._serving = True
        self._server.serve(spec, time.monotonic_ns())
        self._rouse()

    def _refusal(self) -> operator_first.Refusal:
        """Why the policy may not have the arms now."""
        settings, now = self._settings, time.monotonic()
        present = not settings.need_present or self._presence.detected(time.monotonic_ns())
        refusal = operator_first.refusal(
            settings.arms, self._teleop, now, settings.need_teleop, present
        )
        if refusal[0] is StopReason.TELEOP_STATUS and (complaint := self._teleop.complaint(now)):
            rospy.logwarn("no arm is given to a policy: %s", complaint)
        return refusal

    def _now(self) -> int:
        """Time of the execution [ns]."""
        return self._participant.tick * TICK_NS if self._participant else time.monotonic_ns()

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
                self._topics.publish_status(self._server, self._refused, time.monotonic_ns())

    def _wait(self, due: int) -> None:
        """Wait for a message, a callback or a time [ns]."""
        left = max(0, due - time.monotonic_ns())
        ready = dict(self._poller.poll(100 if self._settings.lockstep else left // 1_000_000 + 1))
        if self._wake in ready:
            os.eventfd_read(self._wake)  # type: ignore[attr-defined]

    def _listen(self) -> None:
        """Receive all messages and reply."""
        for peer, parts in self._router.receive():
            self._endpoint.receive(peer, parts, time.monotonic_ns())
        self._answer()

    def _answer(self) -> None:
        for peer, parts in self._endpoint.take_frames():
            self._router.send(peer, parts)

    def _beat(self, now: int) -> None:
        """Free-run: evaluate, observe, send."""
        views = {
            arm: arm_view(cycle) for arm, (at, cycle) in self._cycles.items() if now - at <= FRESH
        }
        cause, obstacle = self._refusal()
        commands = self._server.tick(
            views, now, now, obstacle, self._sources.camera_problem(now, views), cause
        )
        step = self._clock.observe(now)
        if step is not None:
            (stamp_ns, why), wanted = self._sources.add_arms(views), self._server.wanted
            taken = None if stamp_ns is None else self._observer.take(step, stamp_ns, wanted)
            if taken is not None:
                # As old as the oldest cycle or picture in it.
                oldest = min(at for at, _ in self._cycles.values()) - taken.behind
                self._server.observe(taken, oldest, now)
            else:
                missing = "" if stamp_ns is None else self._observer.missing(stamp_ns, wanted)
                self._server.observe_nothing(why or missing)
        for arm, target in self._clock.play(self._server, views, now).items():
            commands[arm] = target.commands()
        self._send(commands, views)
        self._topics.publish_judged(self._server, time.time_ns())
        self._answer()

    def _send(self, commands: dict[str, ArmCommands], views: dict[str, ArmView]) -> None:
        """Send commands, stamped for the cycle after the one that they answer."""
        for arm, command in commands.items():
            answered = views[arm].stamp_ns if arm in views else 0
            command.stamp_ns = answered + TICK_NS if answered else 0
            self._ports[arm].send(command)

    # --- lock-step --------------------------------------------------------------------------------

    def _connect(self) -> None:
        """Answer tick 1, which has no cycle before it, once nothing can get lost."""
        assert self._participant is not None

        def over() -> bool:
            return bool(self.finished.is_set() or rospy.is_shutdown())

        while not over():
            try:
                self._participant.connect(math.inf, over)
            except TimeoutError:
                pass  # the node ends
            except OSError as error:
                rospy.logwarn_throttle(10, "policy: the ROS master does not answer: %s", error)
                time.sleep(0.5)
                continue
            return

    def _on_tick(self, seen: Seen) -> bool | None:
        """All cycles of a tick are here; a tick of the grid is answered by `_grid_tick`."""
        if seen.tick % GRID:
            return False
        self._due = seen.tick
        self._rouse()
        return None

    def _grid_tick(self) -> None:
        """Lock-step: observe, wait for the answer, execute, answer the tick."""
        if self._due is None or self._participant is None:
            return
        tick, self._due = self._due, None
        at, number = tick * TICK_NS, tick // GRID
        # In every state, so that the start of a policy does not depend on rendering time.
        self._await(at, self._sources.image_keys)
        views = {arm: arm_view(cycle) for arm, (_, cycle) in self._cycles.items()}
        cause, obstacle = self._refusal()
        commands = self._server.tick(views, at, time.monotonic_ns(), obstacle, cause=cause)
        if self._server.state is State.RUNNING:
            observation = self._complete(views, number)
            if observation is not None:
                self._server.observe(observation, at, time.monotonic_ns())
                self._answer()
            self._await_answer()
            for arm, target in self._server.execute(number + 1, at).items():
                commands[arm] = target.commands()
        self._send(commands, views)
        self._topics.publish_judged(self._server, at + TICK_NS)
        self._answer()
        self._participant.ready()

    def _complete(self, views: dict[str, ArmView], number: int) -> Observation | None:
        """The observation of a tick; waits for its parts."""
        (stamp_ns, why), wanted = self._sources.add_arms(views), self._server.wanted
        if stamp_ns is None:
            self._server.observe_nothing(why)
            return None
        self._await(stamp_ns, wanted)
        if missing := self._observer.missing(stamp_ns, wanted):
            self._server.observe_nothing(missing)
            return None
        return self._observer.take(number, stamp_ns, wanted)

    def _await(self, stamp_ns: int, keys: Sequence[str]) -> None:
        """Wait for the values of one stamp; meanwhile messages are answered."""
        deadline = time.monotonic_ns() + PATIENCE
        while self._observer.missing(stamp_ns, keys):
            if time.monotonic_ns() > deadline or self.finished.is_set():
                return
            self._wait_unlocked()
            self._listen()

    def _await_answer(self) -> None:
        deadline = time.monotonic_ns() + round(self._settings.answer_timeout * SECOND_NS)
        while self._server.unanswered:
            if time.monotonic_ns() > deadline or self.finished.is_set():
                self._server.counters.waited += 1
                return
            self._wait_unlocked()
            self._listen()

    def _wait_unlocked(self) -> None:
        """Wait without the lock, which callbacks need."""
        self._lock.release()
        try:
            self._wait(0)
        finally:
            self._lock.acquire()

    def stop(self) -> None:
        """End the session and pause the arms; no exit leaves an arm moving."""
        with self._lock:
            self._server.end("the model server has ended")
            views = {arm: arm_view(cycle) for arm, (_, cycle) in self._cycles.items()}
            now = self._now()
            commands = self._server.tick(views, now, time.monotonic_ns())
            self._send(commands, views)
            self._answer()
            self._topics.publish_status(self._server, self._refused, time.monotonic_ns())
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
    # rospy's own handler would close the topics before the arms are stopped.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: node.finished.set())
    rospy.loginfo("policies connect to %s", settings.bind)
    try:
        node.run()
    finally:
        node.stop()
        rospy.signal_shutdown("policy: done")
    return 0
