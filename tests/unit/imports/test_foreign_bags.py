"""Bags of others: each message is kept at its own time, or its loss is counted and refused."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rosbag
from sensor_msgs.msg import CompressedImage, Image, JointState
from std_msgs.msg import Header

from helpers.foreign.foreign_pictures import BAYER, OTHERS, raw
from helpers.foreign.foreign_sources import (
    HZ,
    LATENCY_NS,
    PERIOD_NS,
    START_NS,
    BagMessage,
    samples,
    tip,
    write_bag,
)
from surg_recording import episode
from surg_recording.imports import bag_map
from surg_recording.imports.bag_import import import_bag
from surg_recording.imports.ledger import Ledger
from surg_recording.nodes.ros_messages_node import ros_time
from surg_recording.recording_errors import EpisodeError
from surg_recording.video import exact_values, video_file

COUNT = 300
POSE = "/PSM1/measured_cp"


def at_their_times(folder: Path, rows: int) -> None:
    """Every row holds the tip of its own stamp."""
    cycle = episode.read(folder).cycle("PSM1")
    stamps = cycle["stamp_ns"]
    assert len(stamps) == rows and (np.diff(stamps) > 0).all()
    expected = np.array([tip((stamp - START_NS) * 1e-9) for stamp in stamps.tolist()])
    np.testing.assert_allclose(cycle.vector("p_tip"), expected, atol=1e-9)


def late(messages: list[BagMessage]) -> list[BagMessage]:
    """Every fifth arrives 40 ms later than it should: four others overtake it."""
    for each in messages[::5]:
        each.received_ns += 4 * PERIOD_NS
    return sorted(messages, key=lambda each: each.received_ns)


def stalled(messages: list[BagMessage]) -> list[BagMessage]:
    """The network stands still for a second; all come at once."""
    for each in messages[100:200]:
        each.received_ns = messages[200].received_ns
    return messages


def converted(messages: list[BagMessage]) -> list[BagMessage]:
    """Written by a script: the bag's times say when the script ran."""
    for number, each in enumerate(messages):
        each.received_ns = START_NS + 10**15 + number * 1000
    return messages


@pytest.mark.parametrize("change", [late, stalled, converted])
def test_stamps_that_are_right_are_kept_in_their_order(
    change: Callable[[Any], Any], tmp_path: Path
) -> None:
    ledger = Ledger()
    bag = write_bag(tmp_path / "a.bag", change(samples(COUNT)))
    at_their_times(import_bag(bag, tmp_path / "out", ledger=ledger), COUNT)
    assert not ledger.dropped and ledger.kept[POSE] == COUNT


def test_a_few_wrong_stamps_are_left_out_and_counted(tmp_path: Path) -> None:
    messages = samples(COUNT)
    messages[50].stamp_ns += 3_600_000_000_000  # an hour ahead
    messages[90].stamp_ns -= 10 * 1_000_000_000
    messages[120].stamp_ns += 4 * PERIOD_NS  # before it was received
    ledger = Ledger(allowed=0.02)
    bag = write_bag(tmp_path / "a.bag", messages)
    folder = import_bag(bag, tmp_path / "out", ledger=ledger)
    at_their_times(folder, COUNT - 3)
    assert sorted(ledger.dropped[POSE].values()) == [1, 2]
    told = episode.read(folder).manifest["imported"]
    assert told["kept"][POSE] == COUNT - 3 and sum(told["dropped"][POSE].values()) == 3
    with pytest.raises(EpisodeError, match=r"3 of 300 would be lost .* allowed: 0\.5 %"):
        import_bag(bag, tmp_path / "again", ledger=Ledger(allowed=0.005))
    assert not (tmp_path / "again").exists()


@pytest.mark.parametrize(
    ("first", "shift_s", "said"),
    [
        (150, -5.0, "step back by 4.99 s"),
        (150, -0.2, "step back by 0.19 s"),
        (150, 30.0, "step ahead by 30.01 s"),
        (294, -5.0, "step back by 4.99 s"),
    ],
)
def test_a_clock_that_was_set_is_refused_unless_the_bags_time_counts(
    first: int, shift_s: float, said: str, tmp_path: Path
) -> None:
    messages = samples(COUNT)
    for each in messages[first:]:
        each.stamp_ns += round(shift_s * 1e9)
    bag = write_bag(tmp_path / "a.bag", messages)
    with pytest.raises(EpisodeError, match=rf"{POSE}: its stamps {said}.*--stamps bag"):
        import_bag(bag, tmp_path / "out")
    folder = import_bag(bag, tmp_path / "out", own_stamps=False)
    cycle = episode.read(folder).cycle("PSM1")
    np.testing.assert_array_equal(np.diff(cycle["stamp_ns"]), PERIOD_NS)
    assert cycle["stamp_ns"][0] == START_NS + LATENCY_NS


def test_topics_whose_clocks_differ_are_refused(tmp_path: Path) -> None:
    def joints(bag: rosbag.Bag) -> None:
        for n in range(COUNT):
            ns = START_NS + n * PERIOD_NS
            header = Header(stamp=ros_time(ns + 3_600_000_000_000))
            bag.write("/PSM1/measured_js", JointState(header=header, position=[0.1]), ros_time(ns))

    bag = write_bag(tmp_path / "a.bag", samples(COUNT), joints=False, further=joints)
    with pytest.raises(EpisodeError, match=r"3600\.00 s behind those of /PSM1/measured_js"):
        import_bag(bag, tmp_path / "out")


def spoilt(messages: list[BagMessage], how: str, count: int = 30) -> list[BagMessage]:
    for each in messages[:count]:
        if how == "nan":
            each.p = [float("nan"), 0.0, -0.1]
        else:
            each.q = {"zero": (0.0, 0.0, 0.0, 0.0), "long": (2.0, 0.0, 0.0, 0.0)}[how]
    return messages


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("nan", "30 with a value that is not a number"),
        ("zero", "30 without an orientation"),
        ("long", "30 with a quaternion that is not of length 1"),
    ],
)
def test_rows_that_say_nothing_are_refused_by_name(how: str, said: str, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "a.bag", spoilt(samples(COUNT), how))
    with pytest.raises(EpisodeError, match=said):
        import_bag(bag, tmp_path / "out")
    folder = import_bag(bag, tmp_path / "out", ledger=Ledger(allowed=0.2))
    at_their_times(folder, COUNT - 30)


@pytest.mark.parametrize("how", ["nan", "zero", "long"])
def test_a_bag_that_says_nothing_at_all_is_refused(how: str, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "a.bag", spoilt(samples(COUNT), how, COUNT))
    with pytest.raises(EpisodeError, match=f"{COUNT} of {COUNT} would be lost"):
        import_bag(bag, tmp_path / "out")
    with pytest.raises(EpisodeError, match=r"can be used|0 samples"):
        import_bag(bag, tmp_path / "out", ledger=Ledger(allowed=1.0))


def test_joints_that_began_later_are_not_invented(tmp_path: Path) -> None:
    def joints(bag: rosbag.Bag) -> None:
        for n in range(150, COUNT):
            ns = START_NS + n * PERIOD_NS
            state = JointState(header=Header(stamp=ros_time(ns)), position=[0.01 * n])
            bag.write("/PSM1/measured_js", state, ros_time(ns + LATENCY_NS))

    bag = write_bag(tmp_path / "a.bag", samples(COUNT), joints=False, further=joints)
    with pytest.raises(EpisodeError, match=r"130 without a message of /PSM1/measured_js"):
        import_bag(bag, tmp_path / "out")
    ledger = Ledger(allowed=0.5)
    folder = import_bag(bag, tmp_path / "out", ledger=ledger)
    cycle = episode.read(folder).cycle("PSM1")
    np.testing.assert_allclose(cycle.joints("qd")[30:-1], 0.01 * HZ, rtol=1e-6)
    assert any("velocities are differences" in words for words in ledger.assumed)


def test_poses_without_stamps_need_the_bags_time(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "a.bag", samples(COUNT), stamped=False)
    with pytest.raises(EpisodeError, match=r"geometry_msgs/Pose have no stamp.*--stamps bag"):
        import_bag(bag, tmp_path / "out")
    folder = import_bag(bag, tmp_path / "out", own_stamps=False)
    assert len(episode.read(folder).cycle("PSM1")) == COUNT


def test_bags_that_others_must_mend_first_name_the_cure(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "whole.bag", samples(COUNT))
    active = tmp_path / "a.bag.active"
    data = bytearray(bag.read_bytes())
    place = data.index(b"index_pos=") + len(b"index_pos=")
    data[place : place + 8] = struct.pack("<Q", 0)
    active.write_bytes(bytes(data))
    with pytest.raises(EpisodeError, match=r"was not closed.*rosbag reindex"):
        import_bag(active, tmp_path / "out")
    cut = tmp_path / "cut.bag"
    cut.write_bytes(bag.read_bytes()[: bag.stat().st_size // 2])
    with pytest.raises(EpisodeError, match=r"cut off or damaged.*rosbag reindex"):
        import_bag(cut, tmp_path / "out")
    alone = tmp_path / "ros2/alone.mcap"
    alone.parent.mkdir()
    alone.touch()
    with pytest.raises(EpisodeError, match=r"metadata\.yaml is missing.*ros2 bag reindex"):
        import_bag(alone, tmp_path / "out")


# --- pictures -------------------------------------------------------------------------------------

COLOURS = {"red": (200, 30, 40), "green": (30, 160, 60), "blue": (40, 60, 190), "grey": (120,) * 3}


def quartered(height: int = 48, width: int = 64) -> np.ndarray[Any, Any]:
    """A picture with a colour in each quarter."""
    image = np.zeros((height, width, 3), np.uint8)
    corners = [
        (slice(0, height // 2), slice(0, width // 2)),
        (slice(0, height // 2), slice(32, 64)),
    ]
    corners += [(slice(24, 48), slice(0, 32)), (slice(24, 48), slice(32, 64))]
    for place, colour in zip(corners, COLOURS.values(), strict=True):
        image[place] = colour
    return image


def camera_bag(path: Path, messages: list[Any], topic: str = "/cam/image_raw") -> Path:
    def pictures(bag: rosbag.Bag) -> None:
        for n, message in enumerate(messages):
            ns = START_NS + 5 * n * PERIOD_NS
            message.header = Header(stamp=ros_time(ns))
            bag.write(topic, message, ros_time(ns + 700_000))

    return write_bag(path, samples(COUNT), further=pictures)


QUICK = ("bayer_rggb8", "bayer_grbg16", "bayer_grbg8; png", "bgr8", "yuyv", "nv12", "rgb16", "8UC4")
ENCODINGS = [
    pytest.param(each, marks=[] if each in QUICK else pytest.mark.full) for each in BAYER + OTHERS
]


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_every_encoding_arrives_with_its_colours(encoding: str, tmp_path: Path) -> None:
    ledger = Ledger()
    bag = camera_bag(tmp_path / "a.bag", [raw(encoding, quartered()) for _ in range(4)])
    video = episode.read(import_bag(bag, tmp_path / "out", ledger=ledger)).video("cam")
    (shown,) = video_file.grab(video.path, [2])
    for (row, column), colour in zip(
        [(12, 16), (12, 48), (36, 16), (36, 48)], COLOURS.values(), strict=True
    ):
        assert np.abs(shown[row, column].astype(int) - colour).max() <= 3, colour
    assert ledger.kept["cam"] == 4
    assert encoding == "bgr8" or ledger.converted["cam"].startswith(encoding)


def test_compressed_depth_keeps_its_numbers(tmp_path: Path) -> None:
    metres = np.linspace(0.05, 0.4, 48 * 64).reshape(48, 64).astype(np.float32)
    a, b = 100.0, 0.5
    inverse = np.round(a / metres + b).astype(np.uint16)
    made = []
    for kind, values in (("32FC1", inverse), ("16UC1", (metres * 1000).astype(np.uint16))):
        png = cv2.imencode(".png", values)[1].tobytes()
        data = struct.pack("<iff", 0, a, b) + png
        message = CompressedImage(format=f"{kind}; compressedDepth png", data=data)
        bag = camera_bag(tmp_path / f"{kind}.bag", [message] * 2, "/depth/compressedDepth")
        found = episode.read(import_bag(bag, tmp_path / kind))
        made.append(next(exact_values.read(found.video(found.cameras[0]).path)))
    np.testing.assert_allclose(made[0], a / (inverse - np.float32(b)), rtol=1e-6)
    np.testing.assert_array_equal(made[1], (metres * 1000).astype(np.uint16))


def test_pictures_that_cannot_be_decoded_refuse_the_import(tmp_path: Path) -> None:
    messages = [raw("rgb16", quartered()) for _ in range(3)] + [
        Image(Header(), 48, 64, "64FC2", 0, 1024, b"")
    ]
    bag = camera_bag(tmp_path / "a.bag", messages)
    with pytest.raises(EpisodeError, match=r"cam: 1 of 4 would be lost .*encoding '64FC2'"):
        import_bag(bag, tmp_path / "out")
    assert not list(tmp_path.glob("out*"))
    stated = {"arms": {"PSM1": {"measured_cp": POSE}}, "cameras": {"endoscope": POSE}}
    with pytest.raises(EpisodeError, match="geometry_msgs/PoseStamped cannot be used"):
        import_bag(bag, tmp_path / "out", bag_map.of_yaml(stated))


def test_pictures_that_were_cut_are_no_grey_ones(tmp_path: Path) -> None:
    """OpenCV fills what is missing, and says nothing."""
    jpeg = cv2.imencode(".jpg", quartered()[..., ::-1])[1].tobytes()
    messages = [CompressedImage(format="jpeg", data=jpeg[: len(jpeg) // n]) for n in (1, 1, 2)]
    bag = camera_bag(tmp_path / "a.bag", messages, "/cam/image_raw/compressed")
    with pytest.raises(EpisodeError, match=r"cam: 1 of 3 would be lost .*JPEG picture that is cut"):
        import_bag(bag, tmp_path / "out")


def test_pictures_that_came_late_are_in_the_order_of_their_stamps(tmp_path: Path) -> None:
    def pictures(bag: rosbag.Bag) -> None:
        for n in range(20):
            ns = START_NS + 5 * n * PERIOD_NS
            delay = 120_000_000 if n % 4 == 1 else 700_000
            image = np.full((48, 64, 3), 20 + 10 * n, np.uint8)
            message = Image(Header(stamp=ros_time(ns)), 48, 64, "rgb8", 0, 192, image.tobytes())
            bag.write("/cam/image_raw", message, ros_time(ns + delay))

    bag = write_bag(tmp_path / "a.bag", samples(COUNT), further=pictures)
    video = episode.read(import_bag(bag, tmp_path / "out")).video("cam")
    levels = [image.mean() for image in video_file.grab(video.path, range(20))]
    np.testing.assert_allclose(levels, 20 + 10 * np.arange(20), atol=3)
    expected = START_NS + 5 * PERIOD_NS * np.arange(20)
    np.testing.assert_array_equal(video.frames["stamp_ns"], expected)


def test_the_account_is_a_page_and_a_json(tmp_path: Path) -> None:
    from surg_recording.imports.import_page import Account, write_account

    ledger = Ledger(allowed=0.02)
    messages = samples(COUNT)
    messages[50].stamp_ns += 3_600_000_000_000
    folder = import_bag(write_bag(tmp_path / "a.bag", messages), tmp_path / "a", ledger=ledger)
    accounts = [Account("a.bag", folder, "", ledger), Account("b.bag", None, "is none", Ledger())]
    page = write_account(tmp_path, accounts).read_text("utf-8")
    assert "stamped more than 1 s off" in page and "is none" in page
    first, second = json.loads((tmp_path / "import.json").read_text("utf-8"))["imports"]
    assert first["kept"][POSE] == COUNT - 1 and second["refused"] == "is none"
