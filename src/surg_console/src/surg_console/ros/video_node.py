"""The console's encoder: subscribes to the endoscope, writes encoded pictures to standard output.

A process of its own, started by the console node (`encoder_process`), so that pictures never delay
an input. Only the newest picture waits. Arguments: the ROS name and the views (``left`` or
``left,right``).
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time

import av
import rospy
from sensor_msgs.msg import Image

from surg_console.web.codec import CodecError, image_of
from surg_console.web.picture_streams import (
    EYES,
    CameraFrame,
    PictureStream,
    StereoPairer,
    parse_line,
)

POLL = 0.2


class Encoder:
    """Encodes in the main thread; pictures arrive in rospy's threads."""

    def __init__(self, views: tuple[str, ...], out: int) -> None:
        self._out = out
        self._wanted: dict[tuple[str, str], int] = {}
        self._keys: set[tuple[str, str]] = set()
        self._arrived = threading.Condition()
        self._pairers = {
            layout: StereoPairer(eyes) for layout, eyes in EYES.items() if set(eyes) <= set(views)
        }
        self._waiting: dict[str, tuple[CameraFrame, ...]] = {}
        self._streams: dict[tuple[str, str], PictureStream] = {}
        self._subscribers = [
            rospy.Subscriber(
                f"/endoscope/{view}/image_raw",
                Image,
                self._on_image,
                view,
                queue_size=1,
                buff_size=1 << 23,  # a whole picture, or rospy falls behind for good
                tcp_nodelay=True,
            )
            for view in views
        ]

    def _on_image(self, message: Image, view: str) -> None:
        received = time.time_ns() // 1000
        if not self._wanted:
            return
        try:
            pixels = image_of(
                message.data, message.width, message.height, message.step, message.encoding
            )
        except CodecError as error:
            rospy.logwarn_throttle(10, f"console: {view} eye: {error}")
            return
        stamp = message.header.stamp.to_nsec() // 1000
        frame = CameraFrame(stamp, received, pixels, message.encoding)
        with self._arrived:
            for layout, pairer in self._pairers.items():
                frames = pairer.add(view, frame)
                if frames is not None:
                    self._waiting[layout] = frames
                    self._arrived.notify()

    def read_commands(self) -> None:
        """Thread: read the server's commands until the end of the input."""
        for line in sys.stdin:
            if not line.strip():
                continue
            try:
                word, streams = parse_line(line)
            except CodecError as error:
                rospy.logwarn(f"console: {error}")
                continue
            with self._arrived:
                if word == "want":
                    self._wanted = streams
                else:
                    self._keys |= streams.keys()
        rospy.signal_shutdown("the console has ended")
        with self._arrived:
            self._arrived.notify()

    def run(self) -> None:
        """Encode until shutdown."""
        while not rospy.is_shutdown():
            with self._arrived:
                if not self._waiting:
                    self._arrived.wait(POLL)
                waiting, self._waiting = self._waiting, {}
                wanted, keys, self._keys = self._wanted, self._keys, set()
            self._streams = {pair: s for pair, s in self._streams.items() if pair in wanted}
            for pair in wanted:
                if pair not in self._streams:
                    self._streams[pair] = PictureStream(*pair)
                stream = self._streams[pair]
                stream.space(wanted[pair])
                if pair in keys:
                    stream.request_key()
                frames = waiting.get(pair[0])
                if frames is not None:
                    self._encode(stream, frames)

    def _encode(self, stream: PictureStream, frames: tuple[CameraFrame, ...]) -> None:
        try:
            packet = stream.encode(frames)
        except CodecError as error:
            rospy.logwarn_throttle(10, f"console: {stream.layout}: {error}")
            return
        if packet is not None:
            _write_all(self._out, packet.pack())


def _write_all(fd: int, data: bytes) -> None:
    view = memoryview(data)
    while view:
        view = view[os.write(fd, view) :]


def main() -> int:
    """Run the encoder; returns the exit code."""
    os.nice(3)  # inputs go before pictures
    out = os.dup(1)
    os.dup2(2, 1)  # the pipe is for packets only
    name, views = sys.argv[1], tuple(sys.argv[2].split(","))
    av.logging.set_level(av.logging.FATAL)
    rospy.init_node(name, disable_signals=True)
    encoder = Encoder(views, out)
    threading.Thread(target=encoder.read_commands, name="server", daemon=True).start()
    # Signals of the terminal reach this process too; only the end of the input stops it.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    with contextlib.suppress(BrokenPipeError):
        encoder.run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
