"""Prints lines about a running system: `python tip_printer.py PSM1|task`.

Of an arm its tip in its rcm frame [m] and its orientation x, y, z, w, fifty times a second; of the
task every state, as JSON.
A process of its own, because a test's own node belongs to another ROS master.
"""

from __future__ import annotations

import json
import sys
import time

import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped

from surg_msgs.msg import TaskState
from surg_sim.nodes.bridge_messages import task_state


def tip(message: PoseStamped) -> str:
    """The tip, behind the steady clock [s]."""
    p, q = message.pose.position, message.pose.orientation
    place, turn = f"{p.x:.6f} {p.y:.6f} {p.z:.6f}", f"{q.x:.6f} {q.y:.6f} {q.z:.6f} {q.w:.6f}"
    return f"{time.monotonic():.4f} {place} {turn}"


def task(message: TaskState) -> str:
    """What the task says of itself, and how it stands."""
    numbers = task_state(message.names, message.values)
    told = {name: np.asarray(value).tolist() for name, value in numbers.items()}
    stands = ("seed", "phase", "done", "success", "reason")
    return json.dumps(told | {name: getattr(message, name) for name in stands})


def main() -> None:
    """Print until the pipe ends."""
    of = sys.argv[1]
    newest: list[object] = []
    rospy.init_node("tip_printer", anonymous=True, disable_signals=True)

    def keep(message: object) -> None:
        newest[:] = [message]

    source, kind = f"/{of}/local/measured_cp", PoseStamped
    if of == "task":
        source, kind = "/sim/task_state", TaskState
    rospy.Subscriber(source, kind, keep, tcp_nodelay=True)
    while not rospy.is_shutdown():
        if newest:
            print((task if of == "task" else tip)(newest[0]), flush=True)
        time.sleep(0.02)


if __name__ == "__main__":
    main()
