"""Runs in the virtual machine: a V4L2 device of the kernel (vivid) read by the capture process.

Prints one line of JSON. Each part says what it found; the judge is tests/e2e/test_vm_capture.py.
"""

from __future__ import annotations

import fcntl
import json
import os
import struct
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from surg_perception.capture.capture_parameters import CaptureSettings
from surg_perception.capture.device_process import messages
from surg_perception.capture.frame_pipe import DeviceState, Pictures
from surg_perception.capture.picture_source import SourceError, SourceUri, Wanted

VIVID = 0x00F00000 | 0xF000
PATTERN, OSD_TEXT = VIVID, VIVID + 1
NO_TEXT = 2
S_CTRL, QUERYMENU = 0xC008561C, 0xC02C5625
LINK = Path("/dev/v4l/by-id/usb-vivid-video-index0")
DRIVER = Path("/sys/bus/platform/drivers/vivid")
NAME = "vivid.0"
MOST_S = 60.0
SIZE, RATE = (320, 180), 5.0
"""What the emulated processor can draw in time."""


def device() -> str:
    """The first node of the device that captures video."""
    for node in sorted(Path("/sys/class/video4linux").glob("video*")):
        if (node / "name").read_text().strip().endswith("vid-cap"):
            return f"/dev/{node.name}"
    return ""


def link() -> str:
    """Does udev's work: the persistent name leads to the device; returns the device."""
    found = device()
    LINK.parent.mkdir(parents=True, exist_ok=True)
    LINK.unlink(missing_ok=True)
    if found:
        LINK.symlink_to(found)
    return found


def control(name: str, number: int, value: int | str) -> None:
    """Set a control of the device; a text names the entry of its menu."""
    with open(name, "rb+", buffering=0) as file:
        index = 0
        while isinstance(value, str):
            entry = bytearray(struct.pack("=II32sI", number, index, b"", 0))
            fcntl.ioctl(file, QUERYMENU, entry)
            if entry[8:40].split(b"\0")[0].decode() == value:
                value = index
            index += 1
        fcntl.ioctl(file, S_CTRL, struct.pack("=Ii", number, value))


def delivered() -> Iterator[Pictures | DeviceState]:
    """What the process of the device delivers."""
    settings = CaptureSettings(
        source=f"v4l2:{LINK}", layout="mono", eyes=1, width=SIZE[0], height=SIZE[1], rate=RATE
    )
    return messages(settings, Wanted(time.time_ns, time.sleep, SIZE, RATE))


def until(code: str, stream: Iterator[Pictures | DeviceState]) -> DeviceState | None:
    """The first state with this code; None: it does not come in time."""
    end = time.monotonic() + MOST_S
    for message in stream:
        if isinstance(message, DeviceState):
            say(f"{message.code} (waiting for {code})")
            if message.code == code:
                return message
        if time.monotonic() > end:
            return None
    return None


def pictures(stream: Iterator[Pictures | DeviceState], count: int) -> list[Pictures]:
    """The next pictures; fewer if they do not come in time."""
    end, found = time.monotonic() + MOST_S, []
    while len(found) < count and time.monotonic() < end:
        message = next(stream)
        if isinstance(message, Pictures):
            found.append(message)
        else:
            say(f"{message.code}: {message.text}")
    say(f"{len(found)} of {count} pictures")
    return found


def say(text: str) -> None:
    """Show how far this is."""
    print(f"{time.monotonic():.0f} s: {text}", flush=True)


def refused(uri: str, **changes: Any) -> dict[str, str]:
    """Code and text of the error that opening a source meets."""
    try:
        SourceUri.parse(uri).open(Wanted(time.time_ns, time.sleep, **changes)).close()
    except SourceError as error:
        return {"code": error.code, "text": str(error)}
    return {"code": "", "text": "it was opened"}


def without_permission(uri: str) -> dict[str, str]:
    """The same as another user."""
    ear, mouth = os.pipe()
    child = os.fork()
    if child == 0:
        os.setgid(65534)
        os.setuid(65534)
        os.write(mouth, json.dumps(refused(uri)).encode())
        os._exit(0)
    os.waitpid(child, 0)
    found: dict[str, str] = json.loads(os.read(ear, 65536))
    return found


def main() -> int:
    """Try everything; returns the exit code."""
    name = link()
    found: dict[str, Any] = {"device": name}
    if not name:
        print("no vivid", file=sys.stderr)
        return 1
    found["no_device"] = refused("v4l2:/dev/video77")
    os.chmod(name, 0o600)
    found["no_permission"] = without_permission(f"v4l2:{LINK}")
    say(str(found))
    found["wrong_format"] = refused(f"v4l2:{LINK}?format=mjpeg")
    found["wrong_rate"] = refused(f"v4l2:{LINK}", rate=7.0)

    stream = delivered()
    control(name, OSD_TEXT, NO_TEXT)  # it would cover most of so small a picture
    found["bars"] = bool(until("colour_bars", stream))  # the pattern that vivid begins with
    control(name, PATTERN, "100% Color Squares")
    control(name, OSD_TEXT, 0)  # it counts, so that pictures differ
    shown = pictures(stream, 10)
    stamps = np.array([each.stamp_ns for each in shown])
    found["shape"] = list(shown[0].eyes[0].shape)
    found["steps_ms"] = (np.diff(stamps) * 1e-6).round(1).tolist()
    found["ages_ms"] = [round((e.received_ns - e.stamp_ns) * 1e-6, 1) for e in shown]
    found["busy"] = refused(f"v4l2:{LINK}")
    control(name, OSD_TEXT, NO_TEXT)
    found["frozen"] = bool(until("frozen", stream))
    for pattern, code in (("100% Black", "black"), ("100% Blue", "blue")):
        control(name, PATTERN, pattern)
        found[code] = bool(until(code, stream))
    control(name, PATTERN, "100% Color Squares")
    control(name, OSD_TEXT, 0)
    found["live_again"] = len(pictures(stream, 3))

    (DRIVER / "unbind").write_text(NAME)
    link()
    state = until("gone", stream)
    found["unplugged"] = state.text if state else ""
    (DRIVER / "bind").write_text(NAME)
    found["device_again"] = link()
    control(link(), PATTERN, "100% Color Squares")
    found["replugged"] = len(pictures(stream, 3))
    print("RESULT " + json.dumps(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
