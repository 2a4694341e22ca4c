"""The node /<arm>/force on a graph: both forces of a pressed tip, and that none is known.

What input is bad, and why, is in `test_force_watch.py`.
"""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import surg_core
from helpers.force import sensed_cell
from helpers.force.force_bench import ForceBench
from helpers.graph.ros import RosGraph

pytestmark = pytest.mark.ros

PUSH = np.array([0.6, -0.4, 0.5])
"""On the tip, in the world [N]."""


class Robot:
    """An arm at home whose sensor says what the test wants, 250 times a second."""

    def __init__(self, folder: Path) -> None:
        import rospy
        from geometry_msgs.msg import WrenchStamped
        from sensor_msgs.msg import JointState

        from crtk_msgs.msg import StringStamped

        cell = surg_core.load_cell(folder)
        self.arm = cell.arms["PSM1"]
        bench = ForceBench(cell, "PSM1", 5)
        self.q = np.array(self.arm.robot.home)
        self.free, self.pressed = bench.reading(self.q), bench.reading(self.q, PUSH)
        self.reading: np.ndarray | None = self.free

        def out(topic: str, kind: Any) -> Any:
            return rospy.Publisher(f"/PSM1/{topic}", kind, queue_size=5, tcp_nodelay=True)

        self._js, self._cf = (
            out("robot/measured_js", JointState),
            out("flange/measured_cf", WrenchStamped),
        )
        self.mounted = out("tool/mounted", StringStamped)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        import rospy
        from geometry_msgs.msg import WrenchStamped
        from sensor_msgs.msg import JointState

        while not self._stop.wait(0.003):
            stamp = rospy.Time.now()
            names = list(self.arm.robot.joint_names)
            message = JointState(name=names, position=self.q.tolist(), velocity=[0.0] * 6)
            message.header.stamp = stamp
            self._js.publish(message)
            if self.reading is not None:
                told = WrenchStamped()
                told.header.stamp = stamp
                f, t = told.wrench.force, told.wrench.torque
                f.x, f.y, f.z, t.x, t.y, t.z = (float(v) for v in self.reading)
                self._cf.publish(told)

    def close(self) -> None:
        """End."""
        self._stop.set()
        self._thread.join()


def test_both_forces_arrive_and_what_is_not_known_has_stamp_0(
    ros_graph: RosGraph, rospy_node: str, tmp_path: Path
) -> None:
    import rospy
    from geometry_msgs.msg import WrenchStamped
    from std_msgs.msg import String

    from crtk_msgs.msg import StringStamped

    folder = tmp_path / "cell"
    folder.mkdir()
    sensed_cell.write(folder)
    robot = Robot(folder)
    heard: dict[str, list[Any]] = {"tool": [], "trocar": [], "status": [], "warning": []}
    ends = [
        rospy.Subscriber(f"/PSM1/{name}/measured_cf", WrenchStamped, heard[name].append)
        for name in ("tool", "trocar")
    ]
    ends += [
        rospy.Subscriber("/PSM1/force/status", String, heard["status"].append),
        rospy.Subscriber("/PSM1/warning", String, heard["warning"].append),
    ]
    params = {"cell": folder, "arm": "PSM1"}
    ros_graph.node("surg_hardware", "force_node", "/PSM1/force", params)

    def status(words: str) -> None:
        said = lambda: bool(heard["status"]) and words in heard["status"][-1].data  # noqa: E731
        ros_graph.wait_for(said, 30.0, f"the status '{words}'")

    def force(name: str) -> np.ndarray:
        f = heard[name][-1].wrench.force
        return np.array([f.x, f.y, f.z])

    def unknown() -> None:
        """Both topics say so from now on, and no force leaves."""
        time.sleep(0.1)
        for name in ("tool", "trocar"):
            before = len(heard[name])
            ros_graph.wait_for(lambda n=name, b=before: len(heard[n]) > b + 5, 10.0, name)
            assert all(m.header.stamp.is_zero() for m in heard[name][before:])

    try:
        status("ok")
        # Each topic has a connection of its own: the status may arrive before either force, and
        # before the warnings are heard.
        ros_graph.wait_for(lambda: heard["tool"] and heard["trocar"], 10.0, "both forces")
        heard_by = ends[-1].get_num_connections
        ros_graph.wait_for(lambda: heard_by() > 0, 10.0, "the connection of the warnings")
        assert np.linalg.norm(force("tool")) < 0.15 and np.linalg.norm(force("trocar")) < 0.15
        robot.reading = robot.pressed
        expected = np.asarray(robot.arm.X_WB)[:3, :3].T @ PUSH
        close = lambda: bool(np.linalg.norm(force("tool") - expected) < 0.25)  # noqa: E731
        ros_graph.wait_for(close, 10.0, "the force")
        assert not heard["tool"][-1].header.stamp.is_zero()
        assert heard["tool"][-1].header.frame_id == "PSM1_base"

        warned = len(heard["warning"])
        robot.reading = None
        status("silent")
        unknown()
        told = lambda: any("silent" in m.data for m in heard["warning"][warned:])  # noqa: E731
        ros_graph.wait_for(told, 10.0, "a warning")
        robot.reading = robot.free
        status("ok")
        other = folder / "calibration" / "tool_long.yaml"
        other.write_text("another tool\n", encoding="utf-8")
        robot.mounted.publish(StringStamped(string="grasper calibration/tool_long.yaml"))
        status("Repeat ./surg calibrate CELL force")
        unknown()
    finally:
        robot.close()
        for end in ends:
            end.unregister()
