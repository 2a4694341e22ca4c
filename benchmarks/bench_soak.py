"""Half an hour of teleoperation in free-run with recording, and every stop explained.

Starts simulator, controller, endoscope (left eye), recorder and teleoperation of `sim_ur5e` on the
shipped limits. A leader on topics works like a surgeon: smooth motion in all directions with
pauses, the clutch every 20 s, the jaw. Every time that the tip does not follow although the hand
has not let go counts as a stop, with what teleoperation and controller say about it. `--json FILE`
writes:

    format          "surg_bench_soak/1"
    machine         {processor, cores, load_before, load_after, date}
    seconds         of teleoperation
    stops           [{at_s, state, arm_state, said}]: nobody asked for them
    clutches        that the hand asked for
    following       part of the time, the clutch left out
    path_m          of the tip's set-point
    rcm_error_mm    {mean, max}, of the recording
    recorded        {cycles, missing_ticks, frames, warnings, outcome}
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from hand_system import hand_system
from machine import this_machine

from surg_cli.host.terminal import Progress, say, table

RATE = 100.0
"""[Hz] of the leader."""
WORK, CLUTCHED = 18.0, 2.0
"""[s] with the clutch released and held, in turn."""
REACH = np.array([0.020, 0.015, 0.012])
"""[m] of the hand's motion from its middle, along the view's axes."""
PERIODS = np.array([[7.3, 2.9], [5.9, 3.7], [9.1, 4.3]])
"""[s] of the two sines along each axis."""
START_S = 60.0
FINISH_S = 180.0
"""[s] that half an hour of rows may take to be checked and named."""


def hand(t: float) -> np.ndarray:
    """Where the hand is after t seconds of work, (3,) [m]: sines under a slow swell with pauses."""
    effort = np.clip(1.5 * math.sin(2 * math.pi * t / 41.0) + 0.8, 0.0, 1.0)
    return np.asarray(REACH * effort * np.sin(2 * math.pi * t / PERIODS).mean(axis=1))


class Surgeon:
    """The leader's topics, and what the robot says meanwhile."""

    def __init__(self) -> None:
        import rospy
        from geometry_msgs.msg import PoseStamped
        from sensor_msgs.msg import JointState, Joy
        from std_msgs.msg import Bool, String

        from crtk_msgs.msg import OperatingState

        self.state, self.arm_state, self.recording = "", "", False
        self.said: list[str] = []
        send = {"queue_size": 10, "tcp_nodelay": True}
        self.pose = rospy.Publisher("/hand/measured_cp", PoseStamped, **send)
        self.grip = rospy.Publisher("/hand/gripper/measured_js", JointState, **send)
        self.clutch = rospy.Publisher("/console/clutch", Joy, **send)
        self.enable = rospy.Publisher("/console/teleop/enable", Bool, **send)
        self.record = rospy.Publisher("/record/record", Bool, latch=True, **send)
        self._heard = [
            rospy.Subscriber("/hand_PSM1/current_state", String, self._on_state),
            rospy.Subscriber("/PSM1/operating_state", OperatingState, self._on_arm),
            rospy.Subscriber("/teleop/warning", String, self._on_words),
            rospy.Subscriber("/PSM1/warning", String, self._on_words),
            rospy.Subscriber("/PSM1/error", String, self._on_words),
            rospy.Subscriber("/record/recording", Bool, self._on_recording),
        ]

    def speak(self, p: np.ndarray, grip: float, clutch: bool) -> None:
        """One sample of the hand."""
        import rospy
        from geometry_msgs.msg import PoseStamped
        from sensor_msgs.msg import JointState, Joy

        message = PoseStamped()
        message.header.stamp = rospy.Time.now()
        position = message.pose.position
        position.x, position.y, position.z = p.tolist()
        message.pose.orientation.w = 1.0
        self.pose.publish(message)
        self.grip.publish(JointState(position=[grip]))
        self.clutch.publish(Joy(buttons=[int(clutch)]))

    def _on_state(self, message: Any) -> None:
        self.state = message.data

    def _on_arm(self, message: Any) -> None:
        self.arm_state = message.state

    def _on_recording(self, message: Any) -> None:
        self.recording = message.data

    def _on_words(self, message: Any) -> None:
        self.said = [*self.said[-4:], message.data]


def work(surgeon: Surgeon, seconds: float) -> dict[str, Any]:
    """Drives for that long; returns what happened."""
    from std_msgs.msg import Bool

    began, stops, clutches = time.monotonic(), [], 0
    looks = following = 0
    was, held_before = "FOLLOWING", False
    with Progress(f"{seconds / 60:.0f} min of teleoperation") as progress:
        step = 0
        while (t := time.monotonic() - began) < seconds:
            held = t % (WORK + CLUTCHED) > WORK
            clutches += held and not held_before
            held_before = held
            surgeon.speak(hand(t), 0.5 + 0.5 * math.sin(2 * math.pi * t / 13.0), held)
            settled = (t % (WORK + CLUTCHED)) > 0.5 and not held  # a hand takes time to land
            if settled:
                looks += 1
                following += surgeon.state == "FOLLOWING"
                if surgeon.state != "FOLLOWING" and was == "FOLLOWING":
                    stops.append(
                        {
                            "at_s": round(t, 2),
                            "state": surgeon.state,
                            "arm_state": surgeon.arm_state,
                            "said": list(surgeon.said),
                        }
                    )
                was = surgeon.state
            if step % int(RATE) == 0:
                progress.update(t / seconds)
                if surgeon.state not in ("FOLLOWING", "CLUTCHED"):
                    surgeon.enable.publish(Bool(True))  # a person would press Enable again
            step += 1
            time.sleep(max(0.0, began + step / RATE - time.monotonic()))
    return {
        "seconds": seconds,
        "stops": stops,
        "clutches": clutches,
        "following": following / max(looks, 1),
    }


def recorded(folder: Path) -> dict[str, Any]:
    """What the episode holds."""
    from surg_recording.episode import episode_reader

    found = episode_reader.read(folder)
    cycle = found.cycle("PSM1")
    ticks = np.asarray(cycle["tick"])
    error = 1e3 * np.asarray(cycle["rcm_error"])
    return {
        "path_m": float(np.linalg.norm(np.diff(cycle.vector("p_set"), axis=0), axis=1).sum()),
        "rcm_error_mm": {"mean": float(error.mean()), "max": float(error.max())},
        "recorded": {
            "cycles": len(ticks),
            "missing_ticks": int(ticks[-1] - ticks[0] + 1 - len(ticks)),
            "frames": {name: found.manifest["videos"][name]["frames"] for name in found.cameras},
            "warnings": list(found.warnings),
            "outcome": found.manifest["outcome"],
        },
    }


def measure(minutes: float) -> dict[str, Any]:
    """Runs the system and the hand."""
    import rospy
    from std_msgs.msg import Bool

    with tempfile.TemporaryDirectory(prefix="surg_bench_soak_") as folder:
        out = Path(folder) / "run"
        with hand_system(Path(folder), out, cameras=("left",)):
            rospy.init_node("bench_soak", disable_signals=True)
            surgeon = Surgeon()
            deadline = time.monotonic() + START_S
            while surgeon.state != "FOLLOWING":
                if time.monotonic() > deadline:
                    raise SystemExit(f"nothing follows: {surgeon.state!r}: {surgeon.said}")
                surgeon.enable.publish(Bool(True))
                for _ in range(int(RATE)):
                    surgeon.speak(hand(0.0), 0.5, False)
                    time.sleep(1.0 / RATE)
            surgeon.record.publish(Bool(True))
            found = work(surgeon, 60.0 * minutes)
            surgeon.record.publish(Bool(False))
            surgeon.enable.publish(Bool(False))
            say(f"{len(found['stops'])} stops in {found['seconds']:.0f} s; the recorder finishes")
            deadline = time.monotonic() + FINISH_S
            while surgeon.recording and time.monotonic() < deadline:
                time.sleep(0.2)
            rospy.signal_shutdown("measured")
        episodes = sorted(path.parent for path in out.rglob("manifest.json"))
        if not episodes:
            raise SystemExit(f"no episode in {out}")
        return {**found, **recorded(episodes[0])}


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="./surg dev bench soak", description=__doc__.split("\n")[0]
    )
    parser.add_argument("--minutes", type=float, default=30.0, help="default 30")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    load = os.getloadavg()[0]
    found = measure(options.minutes)
    machine = this_machine(load)
    result = {"format": "surg_bench_soak/1", "machine": machine, **found}
    rows = [["stops", "clutches", "following", "path", "pivot mean, max", "missing ticks"]]
    error = found["rcm_error_mm"]
    rows.append(
        [
            str(len(found["stops"])),
            str(found["clutches"]),
            f"{100 * found['following']:.2f} %",
            f"{found['path_m']:.1f} m",
            f"{error['mean']:.3f}, {error['max']:.3f} mm",
            str(found["recorded"]["missing_ticks"]),
        ]
    )
    say(table(rows))
    for stop in found["stops"]:
        say(f"  {stop['at_s']} s: {stop['state']} ({stop['arm_state']}): {stop['said']}")
    if options.json:
        options.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return 1 if found["stops"] else 0


if __name__ == "__main__":
    sys.exit(main())
