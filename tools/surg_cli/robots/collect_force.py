"""Records mean readings of a force sensor at standstill for `./surg calibrate CELL force`."""

from __future__ import annotations

import argparse
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np

from surg_cli.graph.collect import TIMEOUT_S, append, check_columns, rests, system_at
from surg_cli.host.terminal import CliError, say
from surg_core.force import force_recording
from surg_core.force.sensor_file import ForceSensor, load_sensor

SECONDS = 0.4
"""Of readings in a mean; an arm counts as still after 0.5 s."""


def collect_forces(arm: Any, to: Path, count: int, options: argparse.Namespace) -> int:
    """Append a row to a recording whenever the arm has come to rest anew, its tool hanging free.

    ``options`` has the `port` of the ROS master and the `timeout` for one posture [s].

    Raises:
        CliError: The cell states no sensor, the file has other columns, no system runs, the arm
            does not come to rest, or the sensor is silent.
    """
    names = list(arm.robot.joint_names)
    serial = "" if arm.hardware is None else arm.hardware.serial
    header = force_recording.header(names, serial)
    sensor = _check(arm, to, header)
    import rospy
    from geometry_msgs.msg import WrenchStamped

    newest: deque[list[float]] = deque(maxlen=round(SECONDS * sensor.rate))

    def feel(message: Any) -> None:
        f, t = message.wrench.force, message.wrench.torque
        newest.append([f.x, f.y, f.z, t.x, t.y, t.z])

    topic = f"/{arm.name}/flange/measured_cf"
    with system_at(options.port):
        rospy.Subscriber(topic, WrenchStamped, feel, queue_size=1000)
        say(f"{count} postures -> {to}; the tool hangs free and still for 0.5 s in each")
        for q in rests(arm, to, count, TIMEOUT_S):
            readings = np.array(newest)
            newest.clear()  # a sensor that falls silent leaves nothing for the next posture
            _check_readings(readings, SECONDS * sensor.rate, topic)
            mean = readings.mean(axis=0)
            append(to, header, force_recording.row(q, mean, len(readings), serial))
    return 0


def _check(arm: Any, to: Path, header: str) -> ForceSensor:
    """The arm's sensor; an existing recording must have the same columns."""
    if arm.force_sensor is None:
        raise CliError(f"calibrate collect: the cell has no force_sensor_{arm.name}.yaml", 2)
    check_columns(to, header)
    return load_sensor(arm.force_sensor)


def _check_readings(readings: np.ndarray, expected: float, topic: str) -> None:
    """Refuse the readings (n, 6) of a sensor that is silent or broken."""
    if len(readings) < 0.5 * expected or not np.isfinite(readings).all():
        raise CliError(
            f"{topic}: {len(readings)} readings in {SECONDS:g} s; expected {expected:.0f} finite "
            "ones: start the sensor's driver"
        )
