"""Records mean readings of a force sensor at standstill for `./surg calibrate CELL force`."""

from __future__ import annotations

import argparse
import os
import queue
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np

from surg_cli.graph import master
from surg_cli.graph.collect import append, check_columns
from surg_cli.host.terminal import Problem, say
from surg_core.force import force_recording
from surg_core.force.sensor_file import ForceSensor, load_sensor
from surg_core.standstill import Standstill

SECONDS = 0.4
"""Of readings in a mean; an arm counts as still after 0.5 s."""


def collect_forces(arm: Any, to: Path, count: int, options: argparse.Namespace) -> int:
    """Append a row to a recording whenever the arm has come to rest anew, its tool hanging free.

    ``options`` has the `port` of the ROS master and the `timeout` for one posture [s].

    Raises:
        Problem: The cell states no sensor, the file has other columns, no system runs, the arm
            does not come to rest, or the sensor is silent.
    """
    names = list(arm.robot.joint_names)
    serial = "" if arm.hardware is None else arm.hardware.serial
    header = force_recording.header(names, serial)
    sensor = _check(arm, to, header)
    uri = f"http://localhost:{options.port}"
    master.nodes(uri)
    os.environ["ROS_MASTER_URI"] = uri
    import rospy
    from geometry_msgs.msg import WrenchStamped
    from sensor_msgs.msg import JointState

    rospy.init_node("surg_calibrate", anonymous=True, disable_signals=True)
    newest: deque[list[float]] = deque(maxlen=round(SECONDS * sensor.rate))
    rests: queue.Queue[np.ndarray] = queue.Queue()
    standstill = Standstill()

    def feel(message: Any) -> None:
        f, t = message.wrench.force, message.wrench.torque
        newest.append([f.x, f.y, f.z, t.x, t.y, t.z])

    def hear(message: Any) -> None:
        where = dict(zip(message.name, message.position, strict=False))
        if set(names) <= set(where) and message.header.stamp.to_nsec() > 0:
            q = np.array([where[name] for name in names])
            rest = standstill.add(message.header.stamp.to_sec(), q)
            if rest is not None:
                rests.put(rest)

    prefix = f"/{arm.name}"
    rospy.Subscriber(f"{prefix}/flange/measured_cf", WrenchStamped, feel, queue_size=1000)
    rospy.Subscriber(f"{prefix}/robot/measured_js", JointState, hear, queue_size=1000)
    say(f"{count} postures -> {to}; the tool hangs free and still for 0.5 s in each")
    for done in range(1, count + 1):
        newest.clear()
        try:
            q = rests.get(timeout=options.timeout)
        except queue.Empty:
            raise Problem(
                f"no new standstill within {options.timeout:g} s; {done - 1} of {count} postures "
                f"are in {to}"
            ) from None
        readings = np.array(newest)
        _check_readings(readings, SECONDS * sensor.rate, f"{prefix}/flange/measured_cf")
        append(to, header, force_recording.row(q, readings.mean(axis=0), len(readings), serial))
        say(f"  {done} of {count}")
    rospy.signal_shutdown("done")
    return 0


def _check(arm: Any, to: Path, header: str) -> ForceSensor:
    """The arm's sensor; an existing recording must have the same columns."""
    if arm.force_sensor is None:
        raise Problem(f"calibrate collect: the cell has no force_sensor_{arm.name}.yaml", 2)
    check_columns(to, header)
    return load_sensor(arm.force_sensor)


def _check_readings(readings: np.ndarray, expected: float, topic: str) -> None:
    """Refuse the readings (n, 6) of a sensor that is silent or broken."""
    if len(readings) < 0.5 * expected or not np.isfinite(readings).all():
        raise Problem(
            f"{topic}: {len(readings)} readings in {SECONDS:g} s; expected {expected:.0f} finite "
            "ones: start the sensor's driver"
        )
