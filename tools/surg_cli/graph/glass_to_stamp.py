"""`./surg calibrate CELL latency`: the time from glass to stamp, by a clock pattern."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import numpy as np

from surg_cli.graph import master
from surg_cli.host import paths
from surg_cli.host.terminal import CliError, say

TOPIC = "/endoscope/left/image_raw"
PAGE = paths.ROOT / "src/surg_perception/src/surg_perception/capture/clock_pattern.html"
START_S = 10.0
"""Longest wait for the first picture."""


def measure(cell: Path, port: int, seconds: float) -> int:
    """Read the clock pattern in the left eye's pictures; print latency, spread and the cell's line.

    Raises:
        CliError: No system runs, no picture comes, or the pictures do not tell the latency.
    """
    uri = f"http://localhost:{port}"
    if "/endoscope" not in master.nodes(uri):
        raise CliError(
            f"calibrate latency: no endoscope runs at {uri}; start it with ./surg up {cell.name}"
        )
    key = "/endoscope/latency"
    subtracted = float(master.call(uri, "getParam", key)) if _has(uri, key) else 0.0
    say(f"Open file://{PAGE} in a browser on this machine, full screen, before the endoscope.")
    ages = _ages(uri, seconds)
    from surg_perception.capture.latency import LatencyError, of_ages

    try:
        found = of_ages(ages, subtracted)
    except LatencyError as error:
        raise CliError(f"calibrate latency: {error}; nothing has changed") from error
    say(
        f"latency {1e3 * found.seconds:.1f} ms (median), spread {1e3 * found.spread:.1f} ms (5 to "
        f"95 %), {found.read} of {found.seen} pictures readable; put into {cell / 'cell.yaml'}:"
    )
    say(f"endoscope:\n  latency: {found.seconds:.4f}")
    return 0


def _has(uri: str, key: str) -> bool:
    return bool(master.call(uri, "hasParam", key))


def _ages(uri: str, seconds: float) -> list[float | None]:
    """Ages of the pictures of some seconds [ms]; None: without a readable pattern."""
    os.environ["ROS_MASTER_URI"] = uri
    import rospy
    from sensor_msgs.msg import Image

    from surg_perception.capture import clock_pattern

    rospy.init_node("surg_calibrate", anonymous=True, disable_signals=True)
    ages: list[float | None] = []

    def on_picture(message: Any) -> None:
        rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
        picture = rows[:, : 3 * message.width].reshape(message.height, message.width, 3)
        shown = clock_pattern.read(picture)
        stamp = message.header.stamp.to_nsec()
        ages.append(None if shown is None else clock_pattern.age_ms(stamp, shown))

    listener = rospy.Subscriber(TOPIC, Image, on_picture, queue_size=1, buff_size=1 << 25)
    try:
        deadline = time.monotonic() + START_S
        while not ages:
            if time.monotonic() > deadline:
                raise CliError(
                    f"calibrate latency: no picture on {TOPIC} within {START_S:.0f} s; "
                    "rostopic echo /diagnostics states why"
                )
            time.sleep(0.05)
        time.sleep(seconds)
    finally:
        listener.unregister()
        rospy.signal_shutdown("done")
    return ages
