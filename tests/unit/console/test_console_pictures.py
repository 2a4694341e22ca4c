"""Camera images of the console: encoding, pairing, queues."""

from __future__ import annotations

import random

import av
import numpy as np
import pytest

from surg_console.web import codec as codec_module
from surg_console.web import picture_packet
from surg_console.web.codec import CodecError, frame_of, image_of
from surg_console.web.picture_packet import LAYOUTS
from surg_console.web.picture_queue import IN_FLIGHT, KEY_PERIOD, STALLED, PictureQueue
from surg_console.web.picture_streams import (
    EYES,
    CameraFrame,
    PictureStream,
    StereoPairer,
    parse_line,
)


def shot(count: int, stamp: int, size: tuple[int, int] = (64, 48)) -> CameraFrame:
    width, height = size
    pixels = np.zeros((height, width, 3), np.uint8)
    pixels[..., 0] = np.arange(width)[None, :] * 3
    pixels[: count % height, :, 1] = 200
    return CameraFrame(stamp, stamp + 5, pixels, "rgb8")


def decode(codec: str, packets: list[picture_packet.Packet]) -> list[np.ndarray]:
    context = av.CodecContext.create("h264" if codec == "h264" else "mjpeg", "r")
    frames = []
    for packet in packets:
        frames += context.decode(av.Packet(packet.data))
    frames += context.decode(None)
    return [frame.to_ndarray(format="rgb24") for frame in frames]


@pytest.mark.parametrize("codec", ["h264", "jpeg"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_each_picture_comes_out_at_once_and_looks_as_it_did(codec: str, layout: str) -> None:
    stream = PictureStream(layout, codec)
    packets = []
    for count in range(30):
        shots = (shot(count, 1000 * count),) * len(EYES[layout])
        packet = stream.encode(shots)
        assert packet is not None, count
        assert packet.exposed_us == 1000 * count and packet.received_us == 1000 * count + 5
        assert picture_packet.unpack(packet.pack()) == packet
        packets.append(packet)
    frames = decode(codec, packets)
    assert len(frames) == 30
    for count in (0, 10, 29):
        eye = shot(count, 0).pixels
        if layout.endswith("_half"):
            eye = eye.reshape(24, 2, 32, 2, 3).mean(axis=(1, 3))
        wanted = np.hstack([eye] * len(EYES[layout]))
        error = np.abs(frames[count].astype(int) - wanted.astype(int))
        assert error.mean() < 8.0, error.mean()


@pytest.mark.parametrize("installed", [True, False])
@pytest.mark.parametrize("encoding", ["rgb8", "bgr8", "mono8"])
def test_colours_stay_what_they_are_without_opencv_too(
    encoding: str, installed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not installed:
        monkeypatch.setattr(codec_module, "cv2", None)
    red_then_blue = np.zeros((32, 64, 3), np.uint8)
    red_then_blue[:, :32, 0] = red_then_blue[:, 32:, 2] = 220
    seen = {"rgb8": red_then_blue, "bgr8": red_then_blue[..., ::-1], "mono8": red_then_blue[..., 0]}
    frame = frame_of((np.ascontiguousarray(seen[encoding]),) * 2, encoding)
    wanted = red_then_blue if encoding != "mono8" else red_then_blue[..., :1].repeat(3, axis=2)
    error = np.abs(frame.to_ndarray(format="rgb24").astype(int) - np.hstack([wanted] * 2))
    assert error.max() < 12, error.max()


def test_a_key_picture_is_decodable_by_itself() -> None:
    stream = PictureStream("left", "h264")
    packets = []
    for count in range(20):
        if count in (5, 12):
            stream.request_key()
        packets.append(stream.encode((shot(count, 1000 * count),)))
    assert [i for i, packet in enumerate(packets) if packet.key] == [0, 5, 12]
    assert all(packet.profile[0] == 66 for packet in packets if packet.key)  # baseline
    assert len(decode("h264", packets[12:])) == 8


def test_pictures_are_left_out_that_come_too_soon_and_a_key_picture_never_is() -> None:
    stream, kept = PictureStream("left", "h264"), []
    slow = [1300 + 150 * k for k in range(4)]  # [ms] a camera that is late is not thinned out
    for count, ms in enumerate([*range(0, 1200, 50), *slow, *range(1800, 2400, 50)]):
        stream.space(100 if ms < 1800 else 0)
        if ms == 350:
            stream.request_key()
        packet = stream.encode((shot(count, 1000 * (ms + 7 * (count % 2))),))
        if packet is not None:
            kept.append(packet)
    wanted = [0, 100, 200, 300, 350, *range(450, 1200, 100), *slow, *range(1800, 2400, 50)]
    assert [p.exposed_us // 50_000 * 50 for p in kept] == wanted
    assert [p.seq for p in kept] == list(range(1, len(wanted) + 1))
    assert len(decode("h264", kept)) == len(wanted)


def test_another_size_begins_anew() -> None:
    stream = PictureStream("left", "h264")
    assert stream.encode((shot(0, 0),)).key
    packet = stream.encode((shot(1, 1000, (96, 64)),))
    assert packet.key and (packet.width, packet.height) == (96, 64)


def test_eyes_are_paired_by_stamp() -> None:
    pairer = StereoPairer(("left", "right"))
    assert pairer.add("left", shot(0, 1)) is None
    assert pairer.add("left", shot(0, 2)) is None
    assert pairer.add("right", shot(0, 1)) is None  # its partner has been replaced
    pair = pairer.add("right", shot(0, 2))
    assert pair is not None and [each.stamp_us for each in pair] == [2, 2]


def test_images_that_do_not_add_up_are_named() -> None:
    with pytest.raises(CodecError, match="'32FC1'; allowed: rgb8"):
        image_of(b"", 64, 48, 64, "32FC1")
    with pytest.raises(CodecError, match="cannot have"):
        image_of(b"x" * 100, 64, 48, 192, "rgb8")
    odd = image_of(bytes(200 * 33), 65, 33, 200, "rgb8")
    assert odd.shape == (32, 64, 3)
    with pytest.raises(CodecError, match="differ in size"):
        PictureStream("stereo", "jpeg").encode((shot(0, 0), shot(0, 0, (96, 64))))


def test_the_encoders_orders_are_read_strictly() -> None:
    assert parse_line("want left:h264:0 stereo:jpeg:100") == (
        "want",
        {("left", "h264"): 0, ("stereo", "jpeg"): 100},
    )
    assert parse_line("want") == ("want", {})
    assert parse_line("key left:h264") == ("key", {("left", "h264"): 0})
    strange = ("want left:h264:-1", "want left:h264:x")
    for line in ("go left:h264", "want left", "want up:h264", "key left:vp8", *strange):
        with pytest.raises(CodecError, match="allowed"):
            parse_line(line)


def test_bytes_that_are_no_picture_are_refused() -> None:
    good = PictureStream("left", "jpeg").encode((shot(0, 0),)).pack()
    assert (
        picture_packet.size_of(good[: picture_packet.HEADER_BYTES])
        == len(good) - picture_packet.HEADER_BYTES
    )
    for broken in (b"", good[:20], b"X" + good[1:], good + b"x", good[:-1], b"SPIC" + b"\xff" * 60):
        with pytest.raises(picture_packet.PacketError):
            picture_packet.unpack(broken)


def packets(count: int, keys: set[int]) -> list[picture_packet.Packet]:
    return [
        picture_packet.Packet("left", "h264", i in keys, (66, 192, 30), 64, 48, i, i, i, i, b"x")
        for i in range(count)
    ]


def test_a_lane_never_breaks_the_chain_of_pictures() -> None:
    """Whatever a page fetches: each picture it gets builds on one that it got just before."""
    sent = dropped = 0
    for seed in range(300):
        rng = random.Random(seed)
        queue, now, last = PictureQueue(), 0.0, None
        for packet in packets(200, {0, *(i for i in range(200) if rng.random() < 0.1)}):
            now += 0.05
            queue.put(packet)
            if rng.random() < 0.7 and (got := queue.take(now)) is not None:
                assert got.key or (last is not None and got.seq == last + 1), seed
                last = got.seq
                sent += 1
            if last is not None and rng.random() < 0.8:
                queue.drawn(last)
        dropped += queue.dropped
    print(f"{sent} pictures sent, {dropped} dropped")
    assert sent > 10_000 and dropped > 1_000


def test_a_lane_waits_for_the_page_and_forgets_a_dead_one() -> None:
    queue = PictureQueue()
    got = []
    for packet in packets(10, set(range(10))):
        queue.put(packet)
        got.append(queue.take(0.0))
    assert [packet.seq for packet in got if packet] == list(range(IN_FLIGHT))
    queue.drawn(0)
    assert queue.take(0.0).seq == 9  # the newest
    queue.put(packets(1, {0})[0])
    assert queue.take(STALLED / 2) is None
    assert queue.take(STALLED + 0.1) is not None


def test_a_lane_asks_for_a_key_picture_once_in_a_while() -> None:
    queue = PictureQueue()
    assert queue.wants_key(0.0)
    assert not queue.wants_key(KEY_PERIOD / 2)
    assert queue.wants_key(KEY_PERIOD + 0.01)
    queue.put(packets(1, {0})[0])
    assert not queue.wants_key(1.0)
