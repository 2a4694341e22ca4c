"""ROS 1 bytes become the CDR of ROS 2 and back, for every type of the contract."""

import contextlib
import random

import pytest

from helpers.ros2 import drawn_messages as drawn
from surg_cli.graph import topic_contract
from surg_ros2.cdr import Codec, Malformed
from surg_ros2.message_types_node import fields

KINDS = sorted({each.type for each in topic_contract.load().entries if each.direction != "service"})
DRAWS = 40


def test_the_contract_has_types() -> None:
    assert len(KINDS) > 35


@pytest.mark.parametrize("kind", KINDS)
def test_every_type_of_the_contract_is_converted_to_the_byte(kind: str, rng: random.Random) -> None:
    codec = Codec(kind, fields)
    for _ in range(DRAWS):
        message = drawn.draw(kind, rng)
        ours = codec.to_ros2(drawn.packed(message))
        assert ours == drawn.cdr(kind, message)
        back = codec.to_ros1(ours + bytes(-len(ours) % 4))
        assert back == drawn.packed(drawn.without_seq(message))


@pytest.mark.parametrize("kind", KINDS)
def test_cut_or_foreign_bytes_are_refused_and_never_crash(kind: str, rng: random.Random) -> None:
    codec = Codec(kind, fields)
    good = codec.to_ros2(drawn.packed(drawn.draw(kind, rng)))
    for cut in range(len(good)):
        with pytest.raises(Malformed):
            codec.to_ros1(good[:cut])
    with pytest.raises(Malformed, match="ends at"):
        codec.to_ros1(good + bytes(4))
    for _ in range(DRAWS):
        wrong = bytearray(good)
        wrong[rng.randrange(len(wrong))] ^= 1 << rng.randrange(8)
        with contextlib.suppress(Malformed):
            codec.to_ros1(bytes(wrong))


@pytest.mark.parametrize("header", ["00000000", "00070000", "00030000", ""])
def test_another_representation_is_refused_by_name(header: str) -> None:
    codec = Codec("std_msgs/Bool", fields)
    with pytest.raises(Malformed, match=f"std_msgs/Bool: header {header} is not plain"):
        codec.to_ros1(bytes.fromhex(header) + b"\1" * bool(header))


def test_a_huge_length_allocates_nothing() -> None:
    codec = Codec("std_msgs/Float64MultiArray", fields)
    with pytest.raises(Malformed, match="4294967295 items are announced"):
        codec.to_ros1(bytes.fromhex("00010000ffffffff"))


def test_a_text_without_its_zero_is_refused_and_an_empty_one_may_omit_it() -> None:
    codec = Codec("std_msgs/String", fields)
    with pytest.raises(Malformed, match="does not end with a zero"):
        codec.to_ros1(bytes.fromhex("00010000 02000000 6161"))
    assert codec.to_ros1(bytes.fromhex("00010000 00000000")) == bytes(4)
