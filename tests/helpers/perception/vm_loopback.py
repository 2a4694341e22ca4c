"""Runs in the virtual machine: another program's pictures through v4l2loopback, and the capture.

Prints one line of JSON; the judge is tests/e2e/test_vm_loopback.py. The other program writes one
picture that holds both eyes: dark noise on the left, bright noise on the right.
"""

from __future__ import annotations

import json
import multiprocessing
import queue
import sys
import time
from typing import Any

import av
import numpy as np

from helpers.perception.vm_capture import say
from surg_perception.capture.capture_parameters import CaptureSettings
from surg_perception.capture.device_reader import DeviceReader
from surg_perception.capture.frame_pipe import DeviceState, Pictures

DEVICE = "/dev/video0"
SIZE, RATE = (320, 180), 5
DARK, BRIGHT = 60, 160
MOST_S = 180.0


def feed(device: str) -> None:
    """Write pictures until the process is ended."""
    rng = np.random.default_rng(0)
    width, height = SIZE
    with av.open(device, "w", format="v4l2") as out:
        stream = out.add_stream("rawvideo", rate=RATE)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuyv422"
        while True:
            picture = rng.integers(0, 40, (height, width, 3), dtype=np.uint8) + np.uint8(DARK - 20)
            picture[:, width // 2 :] += np.uint8(BRIGHT - DARK)
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24").reformat(format="yuyv422")
            for packet in stream.encode(frame):
                out.mux(packet)
            time.sleep(1.0 / RATE)


class Heard:
    """What the reader hands on."""

    def __init__(self) -> None:
        self.messages: queue.Queue[Pictures | DeviceState] = queue.Queue()

    def pictures(self, count: int) -> list[Pictures]:
        """The next pictures; fewer if they do not come in time."""
        found: list[Pictures] = []
        while len(found) < count and (message := self._next()) is not None:
            if isinstance(message, Pictures):
                found.append(message)
        say(f"{len(found)} of {count} pictures")
        return found

    def state(self, code: str) -> str:
        """The text of the next state with this code; empty: it does not come in time."""
        while (message := self._next()) is not None:
            if isinstance(message, DeviceState) and message.code == code:
                return message.text
        return ""

    def _next(self) -> Pictures | DeviceState | None:
        try:
            message = self.messages.get(timeout=MOST_S)
        except queue.Empty:
            return None
        if isinstance(message, DeviceState):
            say(f"{message.code}: {message.text}")
        return message


def main() -> int:
    """Try everything; returns the exit code."""
    found: dict[str, Any] = {}
    new = multiprocessing.get_context("spawn").Process
    writer = new(target=feed, args=(DEVICE,), daemon=True)
    writer.start()
    heard = Heard()
    settings = CaptureSettings(source=f"v4l2:{DEVICE}", layout="sbs", width=SIZE[0], height=SIZE[1])
    reader = DeviceReader(settings, heard.messages.put)
    shown = heard.pictures(10)
    found["eyes"] = [list(eye.shape) for eye in shown[0].eyes] if shown else []
    found["grey"] = [[float(eye.mean()) for eye in each.eyes] for each in shown]
    stamps = np.array([each.stamp_ns for each in shown])
    found["steps_ms"] = (np.diff(stamps) * 1e-6).round(1).tolist()
    found["ages_ms"] = [round((e.received_ns - e.stamp_ns) * 1e-6, 1) for e in shown]
    writer.kill()
    writer.join()
    say("the other program is killed")
    found["silent"] = heard.state("hung")
    while not heard.messages.empty():
        heard.messages.get()
    writer = new(target=feed, args=(DEVICE,), daemon=True)
    writer.start()
    found["again"] = len(heard.pictures(3))
    reader.close()
    writer.kill()
    print("RESULT " + json.dumps(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
