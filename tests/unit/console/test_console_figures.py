"""The console's figures, read out of messages as bytes."""

from __future__ import annotations

import io
import math

import numpy as np
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState

from surg_console.ros.raw_gauges import depth, force
from surg_console.ros.status_values_node import follower_of
from surg_msgs.msg import HandStatus


def data(message: JointState | WrenchStamped) -> bytes:
    buffer = io.BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


def test_they_are_what_the_messages_say() -> None:
    rng = np.random.default_rng(4)
    for _ in range(300):
        joints = JointState(position=rng.normal(size=int(rng.integers(0, 7))).tolist())
        joints.name = ["yaw", "pitch", "insertion", "roll"][: int(rng.integers(0, 5))]
        joints.velocity = rng.normal(size=int(rng.integers(0, 5))).tolist()
        wrench = WrenchStamped()
        f = wrench.wrench.force
        f.x, f.y, f.z = rng.normal(size=3).tolist()
        joints.header.frame_id = wrench.header.frame_id = "PSM1_base"[: int(rng.integers(0, 10))]
        expected = joints.position[2] if len(joints.position) == 4 else None
        assert depth(data(joints)) == expected
        assert force(data(wrench)) == math.hypot(f.x, f.y, f.z)
    wrench.wrench.force.z = 1e300
    assert force(data(wrench)) == 1e300, "one that cannot be is a number too"


def test_a_scale_is_a_number_or_none() -> None:
    assert [follower_of(HandStatus(scale=x)).scale for x in (0.2, 1)] == [0.2, 1.0]
    strange = (math.inf, -math.inf, math.nan)
    assert [follower_of(HandStatus(scale=x)).scale for x in strange] == [None] * 3


def test_what_is_no_such_message_says_nothing() -> None:
    rng = np.random.default_rng(5)
    whole = data(JointState(name=["yaw"] * 4, position=[0.1, 0.2, 0.3, 0.4]))
    known = [cut for cut in range(len(whole)) if depth(whole[:cut]) is not None]
    assert known and min(known) > len(whole) - 12  # the positions are there, two lengths are not
    assert depth(b"") is None and force(b"") is None
    for _ in range(2000):
        junk = rng.integers(0, 256, int(rng.integers(0, 120)), dtype=np.uint8).tobytes()
        depth(junk)
        force(junk)
