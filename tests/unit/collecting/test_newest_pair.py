"""The newest pair of pictures: one stamp, once, and no older one."""

from __future__ import annotations

import threading
import time

import rospy
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from surg_perception.stereo.newest_pair_node import NewestPair


def picture(at: int) -> Image:
    return Image(header=Header(stamp=rospy.Time(at)))


def test_a_pair_has_one_stamp_and_is_taken_once() -> None:
    pairs = NewestPair()
    assert list(pairs.silent()) == ["left", "right"]
    pairs.add(picture(1), "left")
    assert list(pairs.silent()) == ["right"] and pairs.take(0.0) is None
    pairs.add(picture(2), "right")
    assert pairs.take(0.0) is None, "two stamps"
    pairs.add(picture(2), "left")
    pairs.add(picture(3), "left")
    pairs.add(picture(3), "right")
    pair = pairs.take(0.0)
    assert pair is not None and [each.header.stamp.to_sec() for each in pair] == [3, 3]
    assert pairs.take(0.0) is None


def test_one_eye_is_a_pair_of_one() -> None:
    pairs = NewestPair(("left",))
    pairs.add(picture(1), "left")
    assert [each.header.stamp.to_sec() for each in pairs.take(0.0) or ()] == [1]
    assert pairs.take(0.0) is None and not pairs.silent()


def test_a_wait_ends_with_a_pair_with_a_call_and_in_time() -> None:
    pairs = NewestPair()
    began = time.monotonic()
    assert pairs.take(0.05) is None and time.monotonic() - began >= 0.05
    threading.Timer(0.05, pairs.wake).start()
    assert pairs.take(30.0) is None and time.monotonic() - began < 10.0
    pairs.wake()
    assert pairs.take(30.0) is None, "a call before the wait ends it too"

    def both() -> None:
        for eye in ("right", "left"):
            pairs.add(picture(2), eye)

    threading.Timer(0.05, both).start()
    assert pairs.take(30.0) is not None
