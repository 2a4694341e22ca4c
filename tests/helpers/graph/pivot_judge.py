"""Judges one arm by the simulator's own truth: `python pivot_judge.py PSM1`.

A process of its own, because a test's own node belongs to another ROS master. Two lines of JSON a
second, until the pipe ends. `left_at` is the time on the steady clock of the first cycle in which
the arm is no longer ENABLED, however long its message waited for this process.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from typing import Any

import numpy as np
import rospy

from surg_msgs.msg import Cycle, GroundTruth

STATES = {getattr(Cycle, name): name for name in ("DISABLED", "ENABLED", "PAUSED", "FAULT")}


def vector(message: Any) -> np.ndarray:
    """x, y, z of a message."""
    return np.array([message.x, message.y, message.z])


class Judge:
    """Counts what the arm does, from its cycles and from the truth."""

    def __init__(self, arm: str) -> None:
        self._arm, self._lock = arm, threading.Lock()
        self._state, self._tip = "", np.zeros(3)
        self._cycle_us, self._truth_tick = 0.0, 0
        self.seen: dict[str, Any] = {
            "cycles": 0,
            "late_cycles": 0,
            "longest_cycle_ms": 0.0,
            "ended": {},
            "left_at": 0.0,
            "pivot_mm": 0.0,
            "pivot_enabled_mm": 0.0,
            "way_m": 0.0,
            "speed": 0.0,
        }
        rospy.Subscriber(f"/{arm}/cycle", Cycle, self._hear_cycle, tcp_nodelay=True)
        rospy.Subscriber("/sim/ground_truth/state", GroundTruth, self._hear_truth, tcp_nodelay=True)

    def _hear_cycle(self, message: Cycle) -> None:
        state = STATES[message.state]
        with self._lock:
            self.seen["cycles"] += 1
            period = message.period_us * 1e-3
            self.seen["late_cycles"] += period > 4.0
            self.seen["longest_cycle_ms"] = max(self.seen["longest_cycle_ms"], period)
            if state != self._state and self._state == "ENABLED":
                how = f"{state}({message.reason})"
                self.seen["ended"][how] = self.seen["ended"].get(how, 0) + 1
                waited = (rospy.get_rostime() - message.header.stamp).to_sec()
                self.seen["left_at"] = time.monotonic() - waited
            self._state = state
        self.seen["state"] = state

    def _hear_truth(self, message: GroundTruth) -> None:
        arm = next(arm for arm in message.arms if arm.arm == self._arm)
        axis, tip = vector(arm.shaft_axis), vector(arm.tip)
        away = vector(arm.trocar) - vector(arm.shaft_point)
        off = 1e3 * float(np.linalg.norm(away - away @ axis * axis))
        with self._lock:
            self.seen["pivot_mm"] = max(self.seen["pivot_mm"], off)
            if self._state == "ENABLED":
                self.seen["pivot_enabled_mm"] = max(self.seen["pivot_enabled_mm"], off)
            if self._truth_tick:
                step = float(np.linalg.norm(tip - self._tip))
                self.seen["way_m"] += step
                ticks = max(1, message.tick - self._truth_tick)
                self.seen["speed"] = max(self.seen["speed"], step / (0.002 * ticks))
            self._tip, self._truth_tick = tip, message.tick

    def line(self) -> str:
        """All counts as JSON."""
        with self._lock:
            return json.dumps(self.seen)


def main() -> None:
    """Print until the pipe ends."""
    rospy.init_node("pivot_judge", anonymous=True, disable_signals=True)
    judge = Judge(sys.argv[1])
    while not rospy.is_shutdown():
        print(judge.line(), flush=True)
        time.sleep(0.5)


if __name__ == "__main__":
    main()
