"""One CRTK script for both ROSes, in lock-step: enable, home, a circle of servo_cp poses.

`lockstep_script.py PARTICIPANT ARM TICKS`; crtk_python_client's `ral` is its only way to ROS.
"""

from __future__ import annotations

import math
import sys
import threading

import crtk
from geometry_msgs.msg import PoseStamped

from crtk_msgs.msg import StringStamped
from surg_msgs.msg import Cycle, Ready

RADIUS_M, STEP_RAD, AT_REST, AGAIN_S = 5e-3, 2 * math.pi / 500, 50, 1.0


class Script:
    """The participant: time passes only while it waits for a cycle."""

    def __init__(self, participant: str, arm: str) -> None:
        self.ral = crtk.ral("lockstep")
        self.changed = threading.Condition()
        self.cycle, self.pose = Cycle(), PoseStamped()
        self.tick, self.ready = 0, Ready(participant=participant, arms=[arm], sent=[0])
        self.said = self.ral.publisher("/sim/ready", Ready)
        self.words = self.ral.publisher(f"/{arm}/state_command", StringStamped)
        self.goals = self.ral.publisher(f"/{arm}/servo_cp", PoseStamped)
        self.ears = [
            self.ral.subscriber(f"/{arm}/cycle", Cycle, self.on_cycle, latch=True),
            self.ral.subscriber(f"/{arm}/setpoint_cp", PoseStamped, self.on_pose),
        ]

    def on_cycle(self, message: Cycle) -> None:
        """The controller has done a tick."""
        with self.changed:
            self.cycle = message
            self.changed.notify_all()

    def on_pose(self, message: PoseStamped) -> None:
        """Where the tip shall be."""
        self.pose = message

    def send(self, publisher: object, message: object) -> None:
        """Send a command and count it: the tick waits for it."""
        publisher.publish(message)  # type: ignore[attr-defined]
        self.ready.sent = [self.ready.sent[0] + 1]

    def step(self, done: bool = False) -> None:
        """One tick; said again to whoever was not connected yet."""
        self.tick += 1
        self.ready.tick, self.ready.done = self.tick, done
        with self.changed:
            self.said.publish(self.ready)
            while not self.changed.wait_for(lambda: self.cycle.tick >= self.tick, AGAIN_S):
                self.said.publish(self.ready)

    def run(self, ticks: int) -> None:
        """Enable, home, rest; then the circle."""
        self.step()
        self.send(self.words, StringStamped(string="enable"))
        while self.cycle.state != Cycle.ENABLED:
            self.step()
        self.send(self.words, StringStamped(string="home"))
        while not self.cycle.homed or self.cycle.busy:
            self.step()
        for _ in range(AT_REST):
            self.step()
        goal = PoseStamped(pose=self.pose.pose)
        middle = goal.pose.position
        x, y = middle.x, middle.y
        for k in range(ticks):
            middle.x = x + RADIUS_M * (math.cos(k * STEP_RAD) - 1.0)
            middle.y = y + RADIUS_M * math.sin(k * STEP_RAD)
            self.send(self.goals, goal)
            self.step()
        self.step(done=True)
        print(f"accepted {self.cycle.accepted}", flush=True)


if __name__ == "__main__":
    script = Script(*sys.argv[1:3])
    script.ral.spin_and_execute(script.run, int(sys.argv[3]))
