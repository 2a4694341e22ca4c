"""The node /<arm>/force: forces at tip and trocar from the sensor at the flange."""

from __future__ import annotations

import datetime
import sys
import threading
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped, WrenchStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import String

import surg_core
from crtk_msgs.msg import StringStamped
from surg_core.contract import SECOND_NS
from surg_core.force.estimator import FILLING
from surg_hardware.force.force_watch import ForceWatch, Told
from surg_ros import params

EVERY = 2
"""Readings for each estimate that is sent."""
QUIET_S = 0.02
"""[s] Period at which it says that it does not know."""
PATIENCE_S = 0.1
"""[s] A window that fills again after a gap is no news for so long; the guards keep the force."""


@dataclass(frozen=True)
class Settings:
    """Private parameters."""

    cell: str = params.text(allowed="the folder of a cell")
    arm: str = params.text(allowed="the name of an arm of the cell")


class ForceNode:
    """Hears sensor, robot and controller; tells the guards."""

    def __init__(self, settings: Settings) -> None:
        cell = surg_core.load_cell(settings.cell)
        now = datetime.datetime.now(datetime.UTC)
        self._watch = ForceWatch(cell, settings.arm, now)
        self._folder, self._names = cell.folder, list(cell.arms[settings.arm].robot.joint_names)
        root = f"/{settings.arm}"
        self._frame = f"{settings.arm}_base"
        self._lock = threading.Lock()  # each subscriber calls from a thread of its own
        self._told = ""
        self._known = 0.0  # when a force was sent last
        self._count = 0

        def out(topic: str) -> rospy.Publisher:
            return rospy.Publisher(f"{root}/{topic}", WrenchStamped, queue_size=2, tcp_nodelay=True)

        self._tip, self._trocar = out("tool/measured_cf"), out("trocar/measured_cf")
        self._status = rospy.Publisher(f"{root}/force/status", String, queue_size=2, latch=True)
        self._warning = rospy.Publisher(f"{root}/warning", String, queue_size=2)
        for topic, kind, take in (
            ("robot/measured_js", JointState, self._on_joints),
            ("rcm/measured_cp", PoseStamped, self._on_trocar),
            ("tool/mounted", StringStamped, self._on_tool),
            ("flange/measured_cf", WrenchStamped, self._on_reading),
        ):
            rospy.Subscriber(f"{root}/{topic}", kind, take, queue_size=5, tcp_nodelay=True)

    def _on_joints(self, message: Any) -> None:
        where = {n: k for k, n in enumerate(message.name)}
        order = [where[n] for n in self._names] if set(self._names) <= set(where) else None
        if order is None or message.header.stamp.is_zero():
            return
        q, qd = np.array(message.position), np.array(message.velocity)
        if len(q) == len(qd) == len(message.name):
            with self._lock:
                self._watch.joints(time.monotonic(), q[order], qd[order])

    def _on_trocar(self, message: Any) -> None:
        if not message.header.stamp.is_zero():
            p = message.pose.position
            with self._lock:
                self._watch.trocar(np.array([p.x, p.y, p.z]))

    def _on_tool(self, message: Any) -> None:
        words = str(message.string).split()
        if len(words) == 2:
            with self._lock:
                self._watch.mount(self._folder / words[1])

    def _on_reading(self, message: Any) -> None:
        f, t = message.wrench.force, message.wrench.torque
        reading = np.array([f.x, f.y, f.z, t.x, t.y, t.z])
        with self._lock:
            self._watch.reading(time.monotonic(), message.header.stamp.to_sec(), reading)
            self._count += 1
            if self._count % EVERY == 0:
                told = self._watch.tell(time.monotonic())
                if told.tip is not None:
                    self._known = time.monotonic()
                    self._send(told)

    def _send(self, told: Told) -> None:
        """Publish a force, or with stamp 0 that it is not known."""
        if rospy.is_shutdown():  # its topics are closed
            return
        stamp = rospy.Time(*divmod(round(told.stamp * SECOND_NS), SECOND_NS))
        for output, force in ((self._tip, told.tip), (self._trocar, told.trocar)):
            message = WrenchStamped()
            message.header.frame_id = self._frame
            if force is not None:
                message.header.stamp = stamp
                wrench = message.wrench.force
                wrench.x, wrench.y, wrench.z = (float(v) for v in force)
            output.publish(message)
        if told.reason != self._told:
            self._status.publish(told.sentence)
            if told.reason not in ("ok", "filling", "near_trocar"):
                self._warning.publish(f"force: {told.sentence}")
            self._told = told.reason

    def run(self) -> None:
        """Until shutdown: say what is not known."""
        while not rospy.is_shutdown():
            with self._lock:
                now = time.monotonic()
                told = self._watch.tell(now)
                fills = told.reason == FILLING and now - self._known < PATIENCE_S
                if told.tip is None and not fills:
                    self._send(told)
            time.sleep(QUIET_S)


def main() -> int:
    """Run the node; the exit code is 2 for parameters or files that must not be used."""
    rospy.init_node("force")
    try:
        node = ForceNode(params.read(Settings, rospy.get_param("~", {})))
    except (params.ParamError, surg_core.ConfigError, KeyError) as error:
        print(f"surg_hardware force_node: {error}", file=sys.stderr)
        return 2
    node.run()
    return 0
