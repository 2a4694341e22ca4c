"""The newest pair of pictures: all eyes of one stamp, older ones are dropped."""

from __future__ import annotations

import threading
from typing import Any

import rospy
from sensor_msgs.msg import Image

EYES = ("left", "right")
BUFFER_BYTES = 1 << 25
"""A whole picture, or rospy falls behind for good."""


class NewestPair:
    """Subscribes to the eyes while it listens. Any thread may call it.

    Args:
        eyes: Of the endoscope; a single one is a pair of one.
    """

    def __init__(self, eyes: tuple[str, ...] = EYES) -> None:
        self._eyes = eyes
        self._newest: dict[str, Image] = {}
        self._pair: tuple[Image, ...] | None = None
        self._changed = threading.Condition()
        self._woken = False
        self._subscribers: list[Any] = []

    def listen(self, wanted: bool) -> None:
        """Subscribe, or stop: nobody needs the pictures."""
        if wanted and not self._subscribers:
            self._subscribers = [
                rospy.Subscriber(
                    f"/endoscope/{eye}/image_raw",
                    Image,
                    self.add,
                    eye,
                    queue_size=1,
                    buff_size=BUFFER_BYTES,
                    tcp_nodelay=True,
                )
                for eye in self._eyes
            ]
        elif not wanted and self._subscribers:
            for each in self._subscribers:
                each.unregister()
            self._subscribers = []

    def add(self, message: Image, eye: str) -> None:
        """A picture of an eye has arrived."""
        with self._changed:
            self._newest[eye] = message
            found = [self._newest[each] for each in self._eyes if each in self._newest]
            stamps = {picture.header.stamp.to_nsec() for picture in found}
            if len(found) == len(self._eyes) and len(stamps) == 1:
                self._pair = tuple(found)
                self._changed.notify()

    def wake(self) -> None:
        """End a `take` that waits, or the next one."""
        with self._changed:
            self._woken = True
            self._changed.notify()

    def take(self, timeout: float) -> tuple[Image, ...] | None:
        """The newest pair, once; None: none arrives in time [s], or `wake` was called."""
        with self._changed:
            self._changed.wait_for(lambda: self._pair is not None or self._woken, timeout)
            pair, self._pair, self._woken = self._pair, None, False
            return pair

    def silent(self) -> list[str]:
        """Eyes of which no picture has ever arrived."""
        with self._changed:
            return [eye for eye in self._eyes if eye not in self._newest]
