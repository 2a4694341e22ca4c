"""From a leader's event to the robot's command: the chain's latency in free-run, by the clock.

A leader publishes poses, each a micrometre further than the last, so every command and every cycle
says which pose it answers. Times are from before the pose is published to the receipt of the
answer in this program: the reading of the message by Python is in them. A cycle is published after
the robot's command of the same cycle.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from pathlib import Path

import numpy as np
from hand_system import hand_system

STEP = 1e-6
"""[m] between two poses."""


class Chain:
    """The leader, and what comes back.

    Args:
        poses: How many poses will be published.
    """

    def __init__(self, poses: int) -> None:
        import rospy
        from geometry_msgs.msg import PoseStamped
        from std_msgs.msg import Bool, String

        from surg_msgs.msg import Cycle

        self.sent = np.full(poses, np.nan)
        self.commanded, self.cycled = self.sent.copy(), self.sent.copy()
        self.state, self._command0, self._goal0 = "", None, None
        self.measuring = False
        keys = {"queue_size": None, "tcp_nodelay": True}
        self.pose = rospy.Publisher(
            "/hand/measured_cp", PoseStamped, queue_size=0, tcp_nodelay=True
        )
        self.enable = rospy.Publisher("/console/teleop/enable", Bool, queue_size=1)
        rospy.Subscriber("/hand_PSM1/current_state", String, self._on_state)
        rospy.Subscriber("/PSM1/servo_cp", PoseStamped, self._on_command, **keys)
        rospy.Subscriber("/PSM1/cycle", Cycle, self._on_cycle, **keys)

    def publish(self, index: int) -> None:
        """The leader's pose of an index; counted while measuring."""
        import rospy
        from geometry_msgs.msg import PoseStamped

        message = PoseStamped()
        message.header.stamp = rospy.Time.now()
        message.pose.position.x, message.pose.orientation.w = index * STEP, 1.0
        if self.measuring:
            self.sent[index] = time.monotonic()
        self.pose.publish(message)

    def _on_state(self, message: object) -> None:
        self.state = message.data

    def _on_command(self, message: object) -> None:
        p = message.pose.position
        self._command0 = self._note(np.array([p.x, p.y, p.z]), self._command0, self.commanded)

    def _on_cycle(self, message: object) -> None:
        self._goal0 = self._note(np.array(message.p_goal), self._goal0, self.cycled)

    def _note(self, p: np.ndarray, origin: np.ndarray | None, times: np.ndarray) -> np.ndarray:
        now = time.monotonic()
        if not self.measuring or origin is None:
            return p
        index = round(float(np.linalg.norm(p - origin)) / STEP)
        if 0 < index < len(times) and np.isnan(times[index]):
            times[index] = now
        return origin


def measure(seconds: float, rate: float) -> dict[str, object]:
    """Runs simulator, controller and teleoperation, and publishes."""
    import rospy

    poses = int(seconds * rate)
    with (
        tempfile.TemporaryDirectory() as folder,
        hand_system(Path(folder), Path(folder), record=False) as teleop,
    ):
        rospy.init_node("bench_teleop", disable_signals=True)
        chain = Chain(poses)
        deadline = time.monotonic() + 60.0
        while chain.state != "FOLLOWING":
            if time.monotonic() > deadline:
                raise SystemExit(f"nothing follows: {teleop.name} says {chain.state!r}")
            chain.enable.publish(True)
            for _ in range(int(rate)):
                chain.publish(0)
                time.sleep(1.0 / rate)
        chain.measuring = True
        cpu, began = _cpu(teleop.process.pid), time.monotonic()
        for index in range(1, poses):
            chain.publish(index)
            time.sleep(1.0 / rate)
        cpu = (_cpu(teleop.process.pid) - cpu) / (time.monotonic() - began)
        time.sleep(0.2)
        chain.measuring = False
        rospy.signal_shutdown("measured")
    return {
        "poses": poses - 1,
        "rate_hz": rate,
        "load": [round(x, 1) for x in os.getloadavg()],
        "teleop_cpu_share": round(cpu, 3),
        "to_servo_cp_ms": _figures(chain.commanded - chain.sent),
        "to_robot_command_ms": _figures(chain.cycled - chain.sent),
    }


def _cpu(pid: int) -> float:
    """CPU time of a process so far [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text("utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _figures(latency: np.ndarray) -> dict[str, float]:
    known = 1e3 * latency[np.isfinite(latency)]
    p50, p99 = np.percentile(known, [50, 99]) if len(known) else (np.nan, np.nan)
    return {"p50": round(float(p50), 2), "p99": round(float(p99), 2), "answered": len(known)}


def main() -> None:
    """Measures once and prints JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--duration", type=float, default=30.0, help="seconds")
    parser.add_argument("--rate", type=float, default=100.0, help="poses per second")
    options = parser.parse_args()
    print(json.dumps(measure(options.duration, options.rate), indent=1))


if __name__ == "__main__":
    main()
