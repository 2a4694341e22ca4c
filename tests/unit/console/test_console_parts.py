"""What surrounds the console's session: messages, access, pictures, the list of episodes."""

from __future__ import annotations

import json
import random
from pathlib import Path

import av
import numpy as np
import pytest

from surg_teleop.console.session.episode_list import Episodes
from surg_teleop.console.web import access, page_protocol, picture_packet
from surg_teleop.console.web.codec import CodecError, frame_of, image_of
from surg_teleop.console.web.picture_queue import IN_FLIGHT, KEY_PERIOD, STALLED, PictureQueue
from surg_teleop.console.web.picture_streams import (
    CameraFrame,
    PictureStream,
    StereoPairer,
    parse_line,
)

INPUT = {
    "say": "input",
    "seq": 7,
    "at": 12.5,
    "picture_us": 1_795_262_692_265_404,
    "hand": "rate",
    "p": [0.1, -0.2, 0.3],
    "roll": 0.5,
    "v": [0.01, 0, -0.02],
    "roll_rate": 1,
    "grip": 0.25,
    "clutch": True,
    "camera": False,
}


# --- what a page may say ---


def test_an_input_is_read_as_it_was_written() -> None:
    said = page_protocol.parse(json.dumps(INPUT))
    assert isinstance(said, page_protocol.Input)
    assert said.seq == 7 and said.picture_us == 1_795_262_692_265_404
    assert said.p == (0.1, -0.2, 0.3) and said.v == (0.01, 0.0, -0.02)
    assert said.grip == 0.25 and said.clutch and not said.camera


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "invalid JSON"),
        ("[]", "JSON object"),
        ("{}", "say: None"),
        ('{"say": ["input"]}', "say:"),
        ('{"say": "press", "button": "format", "at": 1}', "button: 'format'; allowed: take"),
        ('{"say": "press", "button": "stop"}', "at: None; allowed: a number"),
        ('{"say": "scale", "value": 7}', "value: 7; allowed: 0.05 to 1"),
        ('{"say": "scale", "value": true}', "value: True; allowed: a number"),
        ('{"say": "scale", "value": NaN}', "NaN is not allowed"),
        ('{"say": "scale", "value": 1e999}', "value: inf"),
        pytest.param('{"say": "scale", "value": 1' + "0" * 400 + "}", "value: 1000", id="no float"),
        ('{"say": "watch", "layout": "left", "codec": "vp8"}', "codec: 'vp8'"),
        ('{"say": "hello", "token": "' + "x" * 300 + '"}', "token"),
        ('{"say": "hello", "tokens": ""}', "unknown key 'tokens'"),
        ("[" * 3000, "invalid JSON"),
        ("x" * 5000, "a message of 5000 characters"),
    ],
)
def test_nonsense_is_refused_with_what_is_allowed(text: str, said: str) -> None:
    with pytest.raises(page_protocol.ProtocolError) as caught:
        page_protocol.parse(text)
    assert said in str(caught.value)


def test_broken_inputs_never_get_through() -> None:
    """Every key of an input, replaced by what it must not be."""
    bad = [None, "x", [], {}, True, -1, 1e9, [1, 2], [1, 2, "3"], [1, 2, None], [0, 0, 1e3], 0.5]
    allowed = {"grip": [None, 0.5], "roll": [-1, 0.5], "roll_rate": [-1, 0.5], "at": [1e9, 0.5]}
    allowed |= {"clutch": [True], "camera": [True], "seq": [], "picture_us": []}
    refused = 0
    for key in set(INPUT) - {"say"}:
        for value in bad:
            if any(
                value is good or (value == good and value is not True)
                for good in allowed.get(key, [])
            ):
                continue
            with pytest.raises(page_protocol.ProtocolError):
                page_protocol.parse(json.dumps({**INPUT, key: value}))
            refused += 1
    print(f"{refused} broken inputs refused")
    assert refused > 100


def test_random_bytes_are_refused() -> None:
    rng = random.Random(1)
    text = json.dumps(INPUT)
    for _ in range(5000):
        at = rng.randrange(len(text))
        broken = text[:at] + chr(rng.randrange(32, 127)) + text[at + rng.randrange(3) :]
        try:
            said = page_protocol.parse(broken)
        except page_protocol.ProtocolError:
            continue
        assert isinstance(said, page_protocol.Input)
        assert np.isfinite([*said.p, *said.v, said.roll, said.roll_rate, said.at]).all()


# --- who may connect ---


def test_loopback_needs_nothing() -> None:
    rules = access.rules("127.0.0.1", 8090)
    assert rules.url == "http://localhost:8090/"
    for host in ("localhost:8090", "127.0.0.1:8090", "[::1]:8090", "LOCALHOST:8090"):
        assert rules.host_allowed(host), host
    for host in (
        None,
        "",
        "localhost",
        "evil.example:8090",
        "localhost:8091",
        "localhost.evil:8090",
    ):
        assert not rules.host_allowed(host), host
    assert rules.origin_allowed("http://localhost:8090")
    for origin in (None, "null", "https://localhost:8090", "http://evil.example", "file://"):
        assert not rules.origin_allowed(origin), origin


@pytest.mark.parametrize("bind", ["0.0.0.0", "192.168.1.7", "::", "10.0.0.1"])
def test_off_loopback_needs_tls_and_token(bind: str, tmp_path: Path) -> None:
    pem = tmp_path / "a.pem"
    pem.write_text("x")
    token = "0123456789abcdef"
    for how, missing in (
        ({}, "--cert and --key and --token-file is missing"),
        ({"token": token}, "--cert and --key is missing"),
        ({"certificate": pem, "key": pem}, "--token-file is missing"),
    ):
        with pytest.raises(access.AccessError, match="needs TLS and a token") as caught:
            access.rules(bind, 8090, ("robot",), **how)
        assert missing in str(caught.value)
    rules = access.rules(bind, 8090, ("robot",), pem, pem, token)
    assert rules.url == "https://robot:8090/", "it stands in the console's log"
    assert rules.fragment == f"#token={token}"
    assert rules.host_allowed("robot:8090")
    assert not rules.host_allowed("localhost:8090")
    assert rules.origin_allowed("https://robot:8090")
    assert not rules.origin_allowed("http://robot:8090")
    assert rules.token_allowed(token)
    assert not rules.token_allowed("") and not rules.token_allowed(token + "0")
    assert not rules.token_allowed("ä" * 16) and not rules.token_allowed("\ud800")


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"bind": "robot"}, "not an IP address"),
        ({"certificate": Path("/nowhere")}, "belong together"),
        ({"certificate": Path("/nowhere"), "key": Path("/nowhere")}, "no such file"),
        ({"token": "short"}, "at least 16"),
        ({"token": "two words that are long"}, "one word"),
    ],
)
def test_what_cannot_be_meant_is_refused(how: dict[str, object], said: str) -> None:
    with pytest.raises(access.AccessError, match=said):
        access.rules(**{"bind": "127.0.0.1", "port": 8090, **how})


def test_a_token_file_is_for_its_owner_alone(tmp_path: Path) -> None:
    file = tmp_path / "token"
    file.write_text("0123456789abcdef\n")
    file.chmod(0o644)
    with pytest.raises(access.AccessError, match="chmod 600"):
        access.read_token(file)
    file.chmod(0o600)
    assert access.read_token(file) == "0123456789abcdef"
    with pytest.raises(access.AccessError, match="No such file"):
        access.read_token(tmp_path / "none")


# --- pictures ---


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
@pytest.mark.parametrize("layout", ["left", "stereo"])
def test_each_picture_comes_out_at_once_and_looks_as_it_did(codec: str, layout: str) -> None:
    stream = PictureStream(layout, codec, lambda: 99)
    packets = []
    for count in range(30):
        shots = (shot(count, 1000 * count),) * (2 if layout == "stereo" else 1)
        packet = stream.encode(shots)
        assert packet is not None, count
        assert packet.exposed_us == 1000 * count and packet.received_us == 1000 * count + 5
        assert picture_packet.unpack(packet.pack()) == packet
        packets.append(packet)
    frames = decode(codec, packets)
    assert len(frames) == 30
    for count in (0, 10, 29):
        wanted = np.hstack([shot(count, 0).pixels] * (2 if layout == "stereo" else 1))
        error = np.abs(frames[count].astype(int) - wanted.astype(int))
        assert error.mean() < 8.0, error.mean()


@pytest.mark.parametrize("encoding", ["rgb8", "bgr8", "mono8"])
def test_colours_stay_what_they_are(encoding: str) -> None:
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
    assert parse_line("want left:h264 stereo:jpeg") == (
        "want",
        frozenset({("left", "h264"), ("stereo", "jpeg")}),
    )
    assert parse_line("want") == ("want", frozenset())
    for line in ("go left:h264", "want left", "want up:h264", "key left:vp8"):
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


# --- the list of episodes ---


def test_episodes_are_listed_with_their_outcome(tmp_path: Path) -> None:
    folder = tmp_path / "episode"
    listed = Episodes(folder)
    assert listed.entries() == []

    def episode(name: str, **manifest: object) -> None:
        (tmp_path / name).mkdir()
        (tmp_path / name / "manifest.json").write_text(json.dumps(manifest))

    done = {"task": {"name": "bgr", "done": True, "success": True}}
    late = {"task": {"name": "bgr", "done": True, "success": False, "reason": "late"}}
    episode("episode", outcome="complete", started_ns=10**9, stopped_ns=3 * 10**9, sim=done)
    episode("episode_2", outcome="incomplete", reason="disk", started_ns=2 * 10**9, sim=late)
    (tmp_path / "episode_3.partial").mkdir()
    (tmp_path / "episode_4").mkdir()
    (tmp_path / "episode_4" / "manifest.json").write_text("[" * 10)
    (tmp_path / "another").mkdir()
    by_name = {entry.name: entry for entry in listed.entries()}
    assert set(by_name) == {"episode", "episode_2", "episode_3", "episode_4"}
    first, second = by_name["episode"], by_name["episode_2"]
    assert (first.outcome, first.seconds, first.success) == ("complete", 2.0, True)
    assert (second.outcome, second.reason, second.success) == ("incomplete", "disk", False)
    assert by_name["episode_3"].outcome == "unfinished"
    assert by_name["episode_4"].outcome == "unreadable"
    assert [entry.name for entry in listed.entries()][-2:] == ["episode_2", "episode"]
