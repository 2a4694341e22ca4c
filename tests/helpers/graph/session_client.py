"""Does `rostopic pub -1` lines in a graph of its own and waits until they have taken effect.

A process beside the test, because a rospy process belongs to one master for life. One line of text
in, one line of JSON out.
"""

from __future__ import annotations

import json
import shlex
import sys
import threading
import time
from dataclasses import dataclass, field
from typing import Any

import genpy
import roslib.message
import rospy
import yaml
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from crtk_msgs.msg import OperatingState
from surg_msgs.msg import GroundTruth, ScalarStamped

STATES = {"enable": "ENABLED", "disable": "DISABLED", "home": "ENABLED", "resume": "ENABLED"}
MOTIONS = ("/rcm/insert", "/rcm/withdraw", "/move_cp", "/move_jp", "/jaw/move_jp")
TIMEOUT_S = 40.0


@dataclass
class Heard:
    """What the arm says, newest value by topic."""

    lock: threading.Condition = field(default_factory=threading.Condition)
    state: Any = None
    busy_edges: int = 0
    joints: list[float] = field(default_factory=list)
    jaw: list[float] = field(default_factory=list)
    tip: list[float] = field(default_factory=list)
    error: float = -1.0
    worst_error: float = 0.0
    worst_truth: float = 0.0
    warnings: list[str] = field(default_factory=list)


class Client:
    """Listens to one arm and publishes what it is told."""

    def __init__(self, arm: str) -> None:
        self.heard, self.arm = Heard(), arm
        self.publishers: dict[str, rospy.Publisher] = {}
        keys = {"queue_size": 100, "tcp_nodelay": True}
        rospy.Subscriber(f"/{arm}/operating_state", OperatingState, self._state, **keys)
        rospy.Subscriber(f"/{arm}/measured_js", JointState, self._joints, **keys)
        rospy.Subscriber(f"/{arm}/jaw/measured_js", JointState, self._jaw, **keys)
        rospy.Subscriber(f"/{arm}/measured_cp", PoseStamped, self._pose, **keys)
        rospy.Subscriber(f"/{arm}/rcm/error", ScalarStamped, self._error, **keys)
        for kind in ("warning", "error"):
            rospy.Subscriber(f"/{arm}/{kind}", String, self._warning, **keys)
        rospy.Subscriber("/sim/ground_truth/state", GroundTruth, self._truth, **keys)

    def _state(self, message: OperatingState) -> None:
        with self.heard.lock:
            before = self.heard.state
            self.heard.busy_edges += int(bool(before and before.is_busy and not message.is_busy))
            self.heard.state = message
            self.heard.lock.notify_all()

    def _joints(self, message: JointState) -> None:
        self.heard.joints = list(message.position)

    def _jaw(self, message: JointState) -> None:
        self.heard.jaw = list(message.position)

    def _pose(self, message: PoseStamped) -> None:
        p = message.pose.position
        self.heard.tip = [p.x, p.y, p.z]

    def _error(self, message: ScalarStamped) -> None:
        with self.heard.lock:
            self.heard.error = float(getattr(message, "data", getattr(message, "value", -1.0)))
            self.heard.worst_error = max(self.heard.worst_error, self.heard.error)

    def _warning(self, message: String) -> None:
        self.heard.warnings.append(message.data)

    def _truth(self, message: GroundTruth) -> None:
        for arm in message.arms:
            a = [getattr(arm.shaft_axis, c) for c in "xyz"]
            d = [getattr(arm.trocar, c) - getattr(arm.shaft_point, c) for c in "xyz"]
            along = sum(x * y for x, y in zip(a, d, strict=True))
            off = [x - along * y for x, y in zip(d, a, strict=True)]
            size = sum(x * x for x in off) ** 0.5
            with self.heard.lock:
                self.heard.worst_truth = max(self.heard.worst_truth, size)

    def publish(self, line: str) -> dict[str, Any]:
        """One `rostopic pub -1 TOPIC TYPE YAML` line; returns what is then the case."""
        words = shlex.split(line)
        assert words[:3] == ["rostopic", "pub", "-1"], line
        topic, kind, text = words[3:]
        message = roslib.message.get_message_class(kind)()
        genpy.message.fill_message_args(message, [yaml.safe_load(text)])
        if topic not in self.publishers:
            # Latched, as rostopic does it: whoever connects late hears it too.
            self.publishers[topic] = rospy.Publisher(
                topic, type(message), queue_size=10, latch=True, tcp_nodelay=True
            )
        heard = self.heard
        with heard.lock:
            heard.worst_error = heard.worst_truth = 0.0
            heard.warnings.clear()
            edges = heard.busy_edges
        self.publishers[topic].publish(message)
        self._wait(topic, message, edges)
        with heard.lock:
            return {
                "state": heard.state.state,
                "homed": heard.state.is_homed,
                "joints": heard.joints,
                "jaw": heard.jaw,
                "tip": heard.tip,
                "worst_error": heard.worst_error,
                "worst_truth": heard.worst_truth,
                "warnings": list(heard.warnings),
            }

    def _wait(self, topic: str, message: Any, edges: int) -> None:
        heard = self.heard

        def reached() -> bool:
            state = heard.state
            if state is None:
                return False
            if topic.endswith("/state_command"):
                homed = message.string != "home" or state.is_homed
                return state.state == STATES[message.string] and homed and not state.is_busy
            if topic.endswith(MOTIONS):
                return heard.busy_edges > edges
            return True

        with heard.lock:
            if not heard.lock.wait_for(reached, TIMEOUT_S):
                raise RuntimeError(
                    f"{topic}: not done within {TIMEOUT_S:.0f} s; state {heard.state}, joints "
                    f"{heard.joints}, warnings {heard.warnings}"
                )
        time.sleep(0.3)  # feedback comes at 100 or 200 Hz


def main() -> None:
    """Serve lines until the input ends."""
    rospy.init_node("first_session", anonymous=True, disable_signals=True)
    client = Client(sys.argv[1])
    for line in sys.stdin:
        try:
            answer = client.publish(line)
        except (RuntimeError, AssertionError, ValueError) as error:
            answer = {"failed": str(error)}
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
