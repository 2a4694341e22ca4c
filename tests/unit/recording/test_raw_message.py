"""What is read of a message's bytes is what the generated classes wrote into them."""

import io
import struct

import pytest

rospy = pytest.importorskip("rospy")

from surg_msgs.msg import Cycle, TaskState  # noqa: E402
from surg_ros.transport.raw_message import RawMessage  # noqa: E402

KINDS = [Cycle, TaskState]


def raw_of(kind: type, message: object) -> RawMessage:
    """The message as a subscriber gets it."""
    buffer = io.BytesIO()
    message.serialize(buffer)
    raw = type("Raw", (RawMessage, kind), {})()
    assert raw.deserialize(buffer.getvalue()) is raw
    return raw


@pytest.mark.parametrize("kind", KINDS)
def test_tick_and_stamp_are_read_without_the_rest(kind: type) -> None:
    for frame in ("", "PSM1_base", "a frame", "Rahmen \u2013 ü"):
        message = kind(tick=2**33 + 5, reason="held")
        message.header.frame_id = frame
        message.header.stamp = rospy.Time(1_700_000_000, 123_456_789)
        raw = raw_of(kind, message)
        assert raw.tick() == 2**33 + 5
        assert raw.stamp() == pytest.approx(1_700_000_000.123456789, abs=1e-6)
        assert kind().deserialize(raw.data) == message


@pytest.mark.parametrize("kind", KINDS)
def test_a_cut_message_has_no_tick(kind: type) -> None:
    whole = raw_of(kind, kind(tick=7)).data
    for length in range(24):  # 16 of the header, an empty frame id, 8 of the tick
        raw = raw_of(kind, kind())
        raw.data = whole[:length]
        with pytest.raises(struct.error):
            raw.tick()
    raw.data = whole[:24]
    assert raw.tick() == 7
