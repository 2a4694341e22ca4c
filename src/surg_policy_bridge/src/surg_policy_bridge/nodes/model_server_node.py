"""The model server as a node: connects policies to the arms.

Parameters: ``~bind`` (tcp://127.0.0.1:5555), ``~keys`` (folder of ./surg policy keys), ``~cell``,
``~arms`` ([PSM1]), ``~mode`` (freerun | lockstep), ``~task``, ``~instruction``, ``~privileged``
(false: do not serve ground truth), ``~forces`` (false: do not serve forces), ``~cameras`` ([]),
``~camera_rate`` (20), ``~clip`` ([jaw]), ``~autostart`` (false), ``~need_teleop`` (true: no policy
runs without the status of a teleoperation node), ``~need_present`` (false), ``~answer_timeout``
(5 s). Exit code 2: invalid parameter or file.
"""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable
from typing import Any

import rospy
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import Image, Joy
from std_msgs.msg import Bool

import surg_core
from surg_core.contract import GRID
from surg_core.force.observed_force import TOPICS
from surg_core.host.niceness import give_way
from surg_msgs.msg import Cycle, DriftStatus, TaskState, TeleopStatus
from surg_policy_bridge.nodes.free_run_node import FreeRun
from surg_policy_bridge.nodes.lock_step_node import LockStep
from surg_policy_bridge.nodes.server_io_node import ServerIO
from surg_policy_bridge.server.listen_address import BindError
from surg_policy_bridge.server.server_parameters import Settings
from surg_policy_client.errors import BadKeys
from surg_policy_client.keys import server_keys
from surg_ros.byte_topics import on_grid
from surg_ros.camera_topic import camera_topic
from surg_ros.master_check import master_is_online
from surg_ros.params import ParamError, read

NICE = 5
"""Niceness: control cycles go before messages, also while somebody floods the port."""


class ModelServerNode:
    """Subscribes, and runs one of the two loops."""

    def __init__(self, io: ServerIO) -> None:
        self._io, self._server, self._sources = io, io.server, io.sources
        self._serving = False
        self._episode_over = False
        self._refused = ""
        self._loop: LockStep | FreeRun = LockStep(io) if io.settings.lockstep else FreeRun(io)
        self._subscribe()
        self._begin_serving()

    def _subscribe(self) -> None:
        settings = self._io.settings

        def listen(topic: str, kind: type, callback: Any, *about: Any, **keys: Any) -> Any:
            keys = {"queue_size": None, "tcp_nodelay": True, **keys}
            return rospy.Subscriber(topic, kind, callback, *about, **keys)

        kind = on_grid(Cycle) if settings.lockstep else Cycle
        inputs = [listen(f"/{arm}/cycle", kind, self._on_cycle, arm) for arm in settings.arms]
        if settings.task or settings.privileged:
            inputs.append(listen("/sim/task_state", TaskState, self._on_task_state))
        for camera in settings.cameras:
            topic, keys = camera_topic(camera)[1], {"queue_size": 2, "buff_size": 1 << 24}
            inputs.append(listen(topic, Image, self._on_image, camera, **keys))
        if settings.forces:
            inputs += self._listen_to_forces(listen)
        if settings.cameras:
            listen("/endoscope/drift", DriftStatus, self._io.on_drift)
        listen("/policy/enable", Bool, self._on_enable)
        listen("/teleop/status", TeleopStatus, self._io.on_teleop)
        if settings.need_present:
            for source in ("/console", "/footpedals"):
                listen(f"{source}/operator_present", Joy, self._io.on_present, source)
        if self._loop.participant is not None:
            self._loop.participant.inputs += inputs

    def _listen_to_forces(self, listen: Callable[..., Any]) -> list[Any]:
        """Subscribe the forces of every arm; returns those without which nothing begins."""
        found = {
            (arm, place): listen(f"/{arm}/{topic}", WrenchStamped, self._on_force, (arm, place))
            for arm in self._io.settings.arms
            for place, topic in TOPICS.items()
        }
        if isinstance(self._loop, LockStep):
            self._loop.force_inputs = found
        return [subscriber for (_, place), subscriber in found.items() if place == "trocar"]

    def _on_force(self, message: WrenchStamped, about: tuple[str, str]) -> None:
        with self._io.lock:
            self._sources.add_force(message, *about)
            self._begin_serving()
            if self._io.settings.lockstep:
                self._io.rouse()

    def _on_cycle(self, message: Cycle, arm: str) -> None:
        participant = self._loop.participant
        if participant is None or message.tick % GRID == 0:
            with self._io.lock:
                self._io.cycles[arm] = (time.monotonic_ns(), message)
        if participant is not None:
            participant.on_cycle(message, arm)

    def _on_task_state(self, message: TaskState) -> None:
        with self._io.lock:
            if self._io.settings.privileged and message.tick % GRID == 0:
                self._sources.add_task_state(message)
                self._begin_serving()
            if message.done and not self._episode_over:
                self._server.episode_over(bool(message.success), message.reason)
                self._io.rouse()
            self._episode_over = bool(message.done)
            if self._loop.participant is not None:
                self._loop.participant.on_task(message)

    def _on_image(self, message: Image, camera: str) -> None:
        with self._io.lock:
            self._sources.add_image(message, camera)
            self._begin_serving()
            if self._io.settings.lockstep:
                self._io.rouse()

    def _on_enable(self, message: Bool) -> None:
        with self._io.lock:
            self._refused = self._server.enable(bool(message.data), self._loop.now())
            if self._refused:
                rospy.logwarn("the policy is not enabled: %s", self._refused)
            self._io.topics.status_due()
            self._io.rouse()

    def _begin_serving(self) -> None:
        """Serve as soon as every source has sent."""
        if self._serving or (spec := self._sources.spec()) is None:
            return
        self._serving = True
        self._server.serve(spec, time.monotonic_ns())
        self._io.rouse()

    def run(self) -> None:
        """Serve until ``finished``."""
        io = self._io
        if isinstance(self._loop, LockStep):
            self._loop.begin()
        while not io.over:
            io.wait(self._loop.patience_ms())
            with io.lock:
                io.listen()
                self._loop.turn()
                io.topics.publish_plan(self._server)
                io.topics.publish_status(self._server, self._refused, time.monotonic_ns())

    def stop(self) -> None:
        """End the session and pause the arms; no exit leaves an arm moving."""
        io = self._io
        with io.lock:
            self._server.end("the model server has ended")
            views = io.views()
            io.send(self._server.tick(views, self._loop.now(), time.monotonic_ns()), views)
            io.reply()
            io.topics.publish_status(self._server, self._refused, time.monotonic_ns())
            io.close()


def main() -> int:
    """Run the node; returns the exit code."""
    if not master_is_online("policy"):
        return 1
    give_way(NICE)
    rospy.init_node("policy", disable_signals=True)
    try:
        settings = read(Settings, rospy.get_param("~", {}))
        cell = surg_core.load_cell(settings.cell)
        settings.check_arms(list(cell.arms), [arm.link for arm in cell.arms.values()])
        keys = server_keys(settings.keys) if settings.keys else None
        io = ServerIO(settings, cell, keys)
    except (ParamError, surg_core.ConfigError, BadKeys, BindError, OSError) as error:
        print(f"policy: {error}", file=sys.stderr, flush=True)
        return 2
    node = ModelServerNode(io)
    # rospy's own handler would close the topics before the arms are stopped.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: io.finished.set())
    rospy.loginfo("policies connect to %s", settings.bind)
    try:
        node.run()
    finally:
        node.stop()
        rospy.signal_shutdown("policy: done")
    return 0
