"""A hand on another machine: streams a known motion, and writes down when it sent what.

``far_hand.py ARM LOG``. Lines on stdin, answered on stdout: ``ready`` (ENABLED and homed?), ``go``
(stream on from the newest set-point), ``rest`` (stop), ``seen`` (what has come back: poses and
pictures), ``quit``. A line of LOG: steady time [s], x, y, z sent [m].

As the teleoperation node does, it says with each command's stamp what it answers, and rests when it
has heard nothing from the arm for 0.1 s.
"""

from __future__ import annotations

import json
import math
import sys
import threading
import time

import rospy
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import Image

from crtk_msgs.msg import OperatingState, StringStamped

RATE = 200.0
SILENCE = 0.1  # [s]
SWING, FREQUENCY = 0.008, 0.5  # [m], [1/s]: 25 mm/s at most


class Hand:
    """One arm's far operator."""

    def __init__(self, arm: str, log: str) -> None:
        self.lock = threading.Lock()
        self.state: OperatingState | None = None
        self.set_point: PoseStamped | None = None
        self.poses, self.pictures, self.picture_at = 0, 0, 0.0
        self.heard = 0.0
        self.latched: PoseStamped | None = None
        self.began = 0.0
        self.log = open(log, "w", buffering=1, encoding="utf-8")  # noqa: SIM115 - to the end
        keys = {"queue_size": 1, "tcp_nodelay": True}
        self.servo = rospy.Publisher(f"/{arm}/servo_cp", PoseStamped, **keys)
        self.words = rospy.Publisher(f"/{arm}/state_command", StringStamped, latch=True, **keys)
        rospy.Subscriber(f"/{arm}/operating_state", OperatingState, self._on_state, **keys)
        rospy.Subscriber(f"/{arm}/setpoint_cp", PoseStamped, self._on_set_point, **keys)
        rospy.Subscriber("/endoscope/left/image_raw", Image, self._on_picture, **keys)
        threading.Thread(target=self._stream, daemon=True).start()

    def _on_state(self, message: OperatingState) -> None:
        self.state = message

    def _on_set_point(self, message: PoseStamped) -> None:
        with self.lock:
            self.set_point, self.poses = message, self.poses + 1
            self.heard = time.monotonic()

    def _on_picture(self, message: Image) -> None:
        self.pictures, self.picture_at = self.pictures + 1, time.monotonic()

    def ready(self) -> bool:
        """Ask for what is missing; whether nothing is."""
        state = self.state
        if state is None or self.servo.get_num_connections() == 0:
            return False
        if state.state != "ENABLED":
            word = "resume" if state.state == "PAUSED" else "enable"
            self.words.publish(StringStamped(string=word))
        elif not state.is_homed:
            self.words.publish(StringStamped(string="home"))
        return state.state == "ENABLED" and state.is_homed and self.set_point is not None

    def go(self) -> None:
        """Engage: from here on, relative to the set-point of this moment."""
        with self.lock:
            self.latched, self.began = self.set_point, time.monotonic()

    def rest(self) -> None:
        """Let go."""
        with self.lock:
            self.latched = None

    def _stream(self) -> None:
        due = time.monotonic()
        while not rospy.is_shutdown():
            due = max(due + 1.0 / RATE, time.monotonic() - 0.1)
            time.sleep(max(0.0, due - time.monotonic()))
            with self.lock:
                if self.latched is None:
                    continue
                now = time.monotonic()
                if now - self.heard > SILENCE:
                    self.latched = None
                    continue
                t = now - self.began
                x = SWING * min(t, 1.0) ** 2 * math.sin(2.0 * math.pi * FREQUENCY * t)
                message = PoseStamped()
                assert self.set_point is not None
                message.header.stamp = self.set_point.header.stamp
                q, p = message.pose.orientation, message.pose.position
                q.x, q.y, q.z, q.w = (getattr(self.latched.pose.orientation, c) for c in "xyzw")
                p.x, p.y, p.z = (getattr(self.latched.pose.position, c) for c in "xyz")
                p.x += x
                self.servo.publish(message)
                self.log.write(f"{now:.6f} {p.x:.9f} {p.y:.9f} {p.z:.9f}\n")


def main(arm: str, log: str) -> int:
    """Obeys stdin."""
    rospy.init_node("far_hand", disable_signals=True)
    hand = Hand(arm, log)
    print("up", flush=True)
    for line in sys.stdin:
        word = line.strip()
        answer: object = True
        if word == "ready":
            answer = hand.ready()
        elif word == "go":
            hand.go()
        elif word == "rest":
            hand.rest()
        elif word == "seen":
            answer = {"poses": hand.poses, "pictures": hand.pictures, "at": hand.picture_at}
        elif word == "quit":
            break
        print(json.dumps(answer), flush=True)
    hand.rest()
    rospy.signal_shutdown("done")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2]))
