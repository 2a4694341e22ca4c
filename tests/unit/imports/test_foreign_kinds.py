"""Kinds of bags and data sets that are rarer, by the programs that write them; a test for each."""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import rosbag
import yaml
from geometry_msgs.msg import (
    Point,
    Pose,
    PoseStamped,
    PoseWithCovariance,
    PoseWithCovarianceStamped,
    Quaternion,
    Transform,
    TransformStamped,
)
from sensor_msgs.msg import CompressedImage, Image, JointState
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from helpers.foreign.foreign_sources import (
    MAP,
    PERIOD_NS,
    START_NS,
    Rows,
    number_picture,
    samples,
    shown_number,
    tip,
    write_bag,
    write_set,
    write_video,
)
from surg_cli.commands.episode import import_recordings
from surg_recording import episode
from surg_recording.episode.verdicts import verdict
from surg_recording.imports import bag_map
from surg_recording.imports.bag_import import import_bag
from surg_recording.imports.ledger import Ledger
from surg_recording.imports.lerobot_reader import import_episode
from surg_recording.imports.lerobot_set import LeRobotData
from surg_recording.nodes.ros_messages_node import ros_time
from surg_recording.recording_errors import EpisodeError
from surg_recording.video import exact_values, video_file

COUNT = 200
POSE, JOINTS, CAMERA = "/PSM1/measured_cp", "/PSM1/measured_js", "/cam/image_raw"
EPISODES = "meta/episodes/chunk-000/file.parquet"
VIDEO = "videos/observation.images.cam"


def numbers_of(folder: Path) -> list[int]:
    """What the pictures show, in the order of their stamps."""
    video = episode.read(folder).video("cam")
    return [shown_number(each) for each in video_file.grab(video.path, range(len(video.frames)))]


def tips_at_their_times(folder: Path, start_ns: int, within: float = 1e-7) -> None:
    cycle = episode.read(folder).cycle("PSM1")
    expected = [tip((stamp - start_ns) * 1e-9) for stamp in cycle["stamp_ns"].tolist()]
    np.testing.assert_allclose(cycle.vector("p_tip"), expected, atol=within)


# --- data sets ------------------------------------------------------------------------------------


def test_several_files_of_one_chunk_each_have_their_own_time(tmp_path: Path) -> None:
    counts = (20, 15, 12)
    root = write_set(tmp_path / "set", [Rows(count, 10) for count in counts], "v3.0")
    write_video(root / VIDEO / "file-001.mp4", map(number_picture, range(12)), 10)
    table = pq.read_table(root / "data/chunk-000/file-000.parquet")
    pq.write_table(table.slice(0, 35), root / "data/chunk-000/file-000.parquet")
    pq.write_table(table.slice(35), root / "data/chunk-000/file-001.parquet")
    rows = pq.read_table(root / EPISODES).to_pylist()
    rows[2] |= {"data/file_index": 1, f"{VIDEO}/file_index": 1, f"{VIDEO}/from_timestamp": 0.0}
    pq.write_table(pa.Table.from_pylist(rows), root / EPISODES)
    for number, count in enumerate(counts):
        folder = import_episode(LeRobotData(root), number, tmp_path / str(number), MAP)
        assert numbers_of(folder) == list(range(count))


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_an_episode_whose_place_in_the_video_is_unknown_is_refused(
    version: str, tmp_path: Path
) -> None:
    root = write_set(tmp_path / "set", [Rows(12, 10), Rows(12, 10)], version)
    if version == "v2.1":  # its videos begin with their episode
        folder = import_episode(LeRobotData(root), 1, tmp_path / "out", MAP)
        assert numbers_of(folder) == list(range(12))
        return
    table = pq.read_table(root / EPISODES)
    pq.write_table(table.drop_columns([f"{VIDEO}/from_timestamp"]), root / EPISODES)
    with pytest.raises(EpisodeError, match="from_timestamp of episode 1 is missing"):
        import_episode(LeRobotData(root), 1, tmp_path / "out", MAP)
    assert not (tmp_path / "out").exists()


CODED = {
    "B-frames, edit list": ["-c:v", "libx264", "-bf", "3", "-g", "12"],
    "HEVC": ["-c:v", "libx265", "-preset", "ultrafast", "-x265-params", "log-level=error"],
    "AV1": ["-c:v", "libaom-av1", "-cpu-used", "8", "-g", "7"],
    "VP9": ["-c:v", "libvpx-vp9"],
    "10 bits": ["-c:v", "libx264", "-pix_fmt", "yuv420p10le"],
    "4:4:4": ["-c:v", "libx264", "-pix_fmt", "yuv444p"],
    "full range": ["-vf", "scale=out_range=pc", "-color_range", "pc", "-c:v", "libx264"],
    "sound": ["-f", "lavfi", "-i", "anullsrc", "-shortest", "-c:v", "libx264"],
    "two cuts": ["-c:v", "libx264", "-x264-params", "keyint=6:open-gop=1:bframes=2"],
}


def recoded(video: Path, *words: str) -> None:
    """The video as FFmpeg writes it with these words."""
    given = video.rename(video.with_suffix(".given.mp4"))
    argv = ["ffmpeg", "-v", "error", "-i", str(given), *words, str(video)]
    subprocess.run(argv, check=True, capture_output=True)


QUICK = ("B-frames, edit list", "AV1", "10 bits", "two cuts")


@pytest.mark.parametrize(
    "kind",
    [pytest.param(each, marks=[] if each in QUICK else pytest.mark.full) for each in CODED],
)
def test_every_row_has_its_picture_from_any_codec(kind: str, tmp_path: Path) -> None:
    root = write_set(tmp_path / "set", [Rows(20, 10), Rows(23, 10)], "v3.0")
    recoded(root / VIDEO / "file-000.mp4", *CODED[kind])
    ledger = Ledger()
    folder = import_episode(LeRobotData(root), 1, tmp_path / "out", MAP, ledger)
    assert numbers_of(folder) == list(range(23)) and not ledger.dropped
    assert ledger.converted == ({"cam": "yuv420p10le to 8 bits"} if kind == "10 bits" else {})


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["-c:v", "libx264", "-bf", "2", "-use_editlist", "0"], "the video has no picture"),
        (["-vf", "fps=5", "-c:v", "libx264"], "the video has no picture"),
        (["-vf", "setpts=PTS*1.02", "-fps_mode", "vfr", "-c:v", "libx264"], "no picture"),
    ],
    ids=["it begins late", "another rate", "a variable rate"],
)
def test_a_video_whose_times_are_not_those_of_the_rows_is_refused(
    words: list[str], said: str, tmp_path: Path
) -> None:
    root = write_set(tmp_path / "set", [Rows(40, 10)])
    recoded(root / VIDEO / "episode_000000.mp4", *words)
    with pytest.raises(EpisodeError, match=said):
        import_episode(LeRobotData(root), 0, tmp_path / "out", MAP)


def test_timestamps_that_were_added_up_in_32_bits_drift_by_less_than_a_row(tmp_path: Path) -> None:
    rows = Rows(3000, 30)
    times = np.cumsum(np.full(3000, 1 / 30, np.float32)) - np.float32(1 / 30)
    rows.columns["timestamp"] = times.astype(float).tolist()
    assert 1e-4 < abs(times[-1] - 2999 / 30) < 1 / 60
    root = write_set(tmp_path / "set", [rows], camera=None)
    folder = import_episode(LeRobotData(root), 0, tmp_path / "out", MAP)
    stamps = episode.read(folder).cycle("PSM1")["stamp_ns"]
    assert np.abs((stamps - stamps[0]) * 1e-9 - np.arange(3000) / 30).max() < 1 / 60
    tips_at_their_times(folder, int(stamps[0]), within=3e-3)


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_the_instruction_is_the_column_that_is_called_so(version: str, tmp_path: Path) -> None:
    root = write_set(tmp_path / "set", [Rows(12, 10)], version, camera=None)
    if version == "v3.0":
        told = {"kind": ["teleop"], "task_index": [0], "task": ["tie a knot"]}
        pq.write_table(pa.table(told), root / "meta/tasks.parquet")
    else:
        line = {"kind": "teleop", "task_index": 0, "task": "tie a knot"}
        (root / "meta/tasks.jsonl").write_text(json.dumps(line))
    recorded = episode.read(import_episode(LeRobotData(root), 0, tmp_path / "out", MAP))
    assert recorded.manifest["run"]["instruction"] == "tie a knot"


def changed(root: Path, **columns: list[Any] | None) -> Path:
    """The rows of the first episode with other columns; None: without it."""
    (file,) = root.rglob("episode_000000.parquet")
    table = pq.read_table(file)
    for name, values in columns.items():
        table = table.drop_columns([name]) if name in table.column_names else table
        table = table if values is None else table.append_column(name, pa.array(values))
    pq.write_table(table, file)
    return root


def test_rows_without_a_number_of_a_task_have_that_of_their_episode(tmp_path: Path) -> None:
    root = changed(write_set(tmp_path / "set", [Rows(12, 10)], camera=None), task_index=None)
    recorded = episode.read(import_episode(LeRobotData(root), 0, tmp_path / "out", MAP))
    assert recorded.manifest["run"]["instruction"] == "pick the needle"


@pytest.mark.parametrize(("last", "success"), [(True, True), (False, False), (None, None)])
def test_an_empty_verdict_is_none(last: bool | None, success: bool | None, tmp_path: Path) -> None:
    verdicts = {"next.success": [*[False] * 11, last]}
    root = changed(write_set(tmp_path / "set", [Rows(12, 10)], camera=None), **verdicts)
    recorded = episode.read(import_episode(LeRobotData(root), 0, tmp_path / "out", MAP))
    assert verdict(recorded.manifest).success is success


def test_a_name_of_two_columns_is_refused(tmp_path: Path) -> None:
    names = ["x", "y", "z", "x", "jaw"]
    root = write_set(tmp_path / "set", [Rows(12, 10)], names=names, camera=None)
    stated: dict[str, Any] = {"arms": {"PSM1": {"measured": {"x": "x", "y": "y", "z": "z"}}}}
    with pytest.raises(EpisodeError, match=r"2 columns of observation\.state are named 'x'"):
        import_episode(LeRobotData(root), 0, tmp_path / "out", stated)
    stated["arms"]["PSM1"]["measured"]["x"] = 0
    import_episode(LeRobotData(root), 0, tmp_path / "out", stated)


@pytest.mark.parametrize("place", ["info", "video_info"])
def test_depth_maps_are_no_grey_pictures(place: str, tmp_path: Path) -> None:
    """LeRobot keeps the logarithm of a depth in a video of grey."""
    root = write_set(tmp_path / "set", [Rows(12, 10)])
    stated = json.loads((root / "meta/info.json").read_text())
    key = "is_depth_map" if place == "info" else "video.is_depth_map"
    stated["features"]["observation.images.cam"][place] = {key: True}
    (root / "meta/info.json").write_text(json.dumps(stated))
    with pytest.raises(EpisodeError, match=r"cam: 12 of 12 would be lost .*depth maps, which are"):
        import_episode(LeRobotData(root), 0, tmp_path / "out", MAP)
    ledger = Ledger(allowed=1.0)
    folder = import_episode(LeRobotData(root), 0, tmp_path / "out", MAP, ledger)
    assert ledger.dropped["cam"] and not episode.read(folder).cameras


def test_episodes_that_were_deleted_leave_a_gap_of_numbers(tmp_path: Path) -> None:
    root = write_set(tmp_path / "set", [Rows(12, 10) for _ in range(3)], camera=None)
    lines = (root / "meta/episodes.jsonl").read_text().splitlines()
    (root / "meta/episodes.jsonl").write_text("\n".join([lines[0], lines[2]]))
    info = json.loads((root / "meta/info.json").read_text())
    (root / "meta/info.json").write_text(json.dumps({**info, "total_episodes": 2}))
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(MAP))
    parser = argparse.ArgumentParser()
    import_recordings.add_arguments(parser, "import")
    words = ["lerobot", str(root), "--map", str(tmp_path / "map.yaml"), "--out"]
    options = parser.parse_args([*words, str(tmp_path / "out")])
    assert import_recordings.main(options, "import") == 0
    assert sorted(p.name for p in (tmp_path / "out").iterdir() if p.is_dir()) == [
        "set_000000",
        "set_000002",
    ]
    options = parser.parse_args([*words, str(tmp_path / "other"), "--only", "1"])
    assert import_recordings.main(options, "import") == 2
    (entry,) = json.loads((tmp_path / "other/import.json").read_text())["imports"]
    assert "there is no episode 1; its 2 are numbered 0 to 2" in entry["refused"]


# --- bags -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("compression", ["bz2", "lz4"])
def test_compressed_chunks_give_the_same_episode(compression: str, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "a.bag", samples(COUNT), compression=compression)
    folder = import_bag(bag, tmp_path / "out")
    tips_at_their_times(folder, START_NS)
    assert len(episode.read(folder).cycle("PSM1")) == COUNT


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_bag_of_ros2_in_several_files_is_one_episode(storage: str, tmp_path: Path) -> None:
    program, halves = Path(sys.executable).with_name("rosbags-convert"), []
    for number, part in enumerate((samples(COUNT)[:120], samples(COUNT)[120:])):
        bag = write_bag(tmp_path / f"part_{number}.bag", part)
        argv = [program, "--src", bag, "--dst", tmp_path / bag.stem, "--dst-storage", storage]
        subprocess.run(argv, check=True, capture_output=True)
        halves.append(tmp_path / bag.stem)
    (second,) = (file for file in halves[1].iterdir() if file.suffix != ".yaml")
    shutil.move(second, halves[0] / second.name)
    stated, other = (yaml.safe_load((half / "metadata.yaml").read_text()) for half in halves)
    about, more = (each["rosbag2_bagfile_information"] for each in (stated, other))
    about["relative_file_paths"] += more["relative_file_paths"]
    about["files"] = [*about.get("files", ()), *more.get("files", ())]
    about["message_count"] += more["message_count"]
    for topic, added in zip(
        about["topics_with_message_count"], more["topics_with_message_count"], strict=True
    ):
        topic["message_count"] += added["message_count"]
    (halves[0] / "metadata.yaml").write_text(yaml.safe_dump(stated))
    for number, path in enumerate((halves[0], halves[0] / second.name)):
        folder = import_bag(path, tmp_path / f"out_{number}")
        tips_at_their_times(folder, START_NS)
        assert len(episode.read(folder).cycle("PSM1")) == COUNT


def poses(
    topic: str, make: Callable[[Header, Pose, int], Any], name: str = "base"
) -> Callable[[rosbag.Bag], None]:
    """Messages of another kind, which hold the poses of ``samples``."""

    def add(bag: rosbag.Bag) -> None:
        for n, each in enumerate(samples(COUNT)):
            header = Header(stamp=ros_time(each.stamp_ns), frame_id=name)
            message = make(header, Pose(Point(*each.p), Quaternion(*each.q)), n)
            bag.write(topic, message, ros_time(each.received_ns))

    return add


def transform(header: Header, pose: Pose, n: int) -> TransformStamped:
    return TransformStamped(header, "tip", Transform(pose.position, pose.orientation))


def uncertain(header: Header, pose: Pose, n: int) -> PoseWithCovarianceStamped:
    return PoseWithCovarianceStamped(header, PoseWithCovariance(pose=pose))


def two_bodies(header: Header, pose: Pose, n: int) -> TransformStamped:
    return TransformStamped(header, f"body_{n % 2}", Transform(pose.position, pose.orientation))


def two_bases(header: Header, pose: Pose, n: int) -> PoseStamped:
    header.frame_id = "base" if n < 150 else "camera"
    return PoseStamped(header, pose)


def tree(header: Header, pose: Pose, n: int) -> TFMessage:
    return TFMessage([transform(header, pose, n)])


@pytest.mark.parametrize("make", [transform, uncertain])
def test_poses_of_other_types_arrive(make: Any, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "a.bag", [], further=poses("/tracker", make))
    chosen = bag_map.of_yaml({"arms": {"PSM1": {"measured_cp": "/tracker"}}})
    folder = import_bag(bag, tmp_path / "out", chosen)
    tips_at_their_times(folder, START_NS)
    assert len(episode.read(folder).cycle("PSM1")) == COUNT


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (two_bodies, "frames are base to body_0 first, then base to body_1; allowed: the same"),
        (two_bases, "frames are base first, then camera; allowed: the same in all messages"),
        (tree, "tf2_msgs/TFMessage cannot be used; allowed: PoseStamped or TransformStamped"),
    ],
)
def test_poses_that_are_not_of_one_body_are_refused(make: Any, said: str, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "a.bag", [], further=poses("/tracker", make))
    chosen = bag_map.of_yaml({"arms": {"PSM1": {"measured_cp": "/tracker"}}})
    with pytest.raises(EpisodeError, match=said):
        import_bag(bag, tmp_path / "out", chosen)


@pytest.mark.parametrize("names", [["b", "c", "a"], ["d", "e", "f"]])
def test_joints_go_by_their_names(names: list[str], tmp_path: Path) -> None:
    """Every second message names them in another order, or is of another robot."""

    def joints(bag: rosbag.Bag) -> None:
        for n, each in enumerate(samples(COUNT)):
            stated = names if n % 2 else ["a", "b", "c"]
            place = {"a": 1.0, "b": 2.0, "c": 3.0, "d": 4.0, "e": 5.0, "f": 6.0}
            state = JointState(name=stated, position=[place[name] for name in stated])
            state.velocity = [0.1 * place[name] for name in stated]
            state.header.stamp = ros_time(each.stamp_ns)
            bag.write(JOINTS, state, ros_time(each.received_ns))

    bag = write_bag(tmp_path / "a.bag", samples(COUNT), joints=False, further=joints)
    ledger = Ledger(allowed=0.01 if "a" in names else 0.6)
    if "a" not in names:
        with pytest.raises(EpisodeError, match=r"100 .*with other joints than the first"):
            import_bag(bag, tmp_path / "out")
    cycle = episode.read(import_bag(bag, tmp_path / "out", ledger=ledger)).cycle("PSM1")
    np.testing.assert_allclose(cycle.joints("q"), [[1.0, 2.0, 3.0]] * COUNT)
    np.testing.assert_allclose(cycle.joints("qd"), [[0.1, 0.2, 0.3]] * COUNT)


def streamed(b_frames: int) -> list[bytes]:
    """Packets of H.264, as a camera's driver sends them."""
    coder = av.CodecContext.create("libx264", "w")
    coder.width, coder.height, coder.pix_fmt = 64, 48, "yuv420p"
    coder.time_base = Fraction(1, 20)
    coder.options = {"bf": str(b_frames), "crf": "4", "x264-params": "b-adapt=0:repeat-headers=1"}
    frames = (av.VideoFrame.from_ndarray(number_picture(k), "rgb24") for k in range(30))
    packets = [packet for frame in frames for packet in coder.encode(frame)]
    return [bytes(packet) for packet in [*packets, *coder.encode(None)]]


@pytest.mark.parametrize("b_frames", [0, 2])
def test_a_video_stream_has_each_picture_at_its_stamp(b_frames: int, tmp_path: Path) -> None:
    def pictures(bag: rosbag.Bag) -> None:
        for n, data in enumerate(streamed(b_frames)):
            stamp = ros_time(START_NS + 5 * n * PERIOD_NS)
            message = CompressedImage(Header(stamp=stamp), "h264", data)
            bag.write(f"{CAMERA}/compressed", message, stamp)

    bag = write_bag(tmp_path / "a.bag", samples(COUNT), further=pictures)
    if b_frames:
        with pytest.raises(EpisodeError, match="with B-frames, which come late"):
            import_bag(bag, tmp_path / "out")
        return
    assert numbers_of(import_bag(bag, tmp_path / "out")) == list(range(30))


@pytest.mark.parametrize("big_endian", [0, 1])
def test_sixteen_bits_of_grey_keep_every_value(big_endian: int, tmp_path: Path) -> None:
    grey = np.arange(48 * 64, dtype=np.uint16).reshape(48, 64) * 21
    content = grey.astype(">u2" if big_endian else "<u2").tobytes()

    def pictures(bag: rosbag.Bag) -> None:
        for n in range(4):
            stamp = ros_time(START_NS + 5 * n * PERIOD_NS)
            message = Image(Header(stamp=stamp), 48, 64, "mono16", big_endian, 128, content)
            bag.write(CAMERA, message, stamp)

    bag = write_bag(tmp_path / "a.bag", samples(COUNT), further=pictures)
    video = episode.read(import_bag(bag, tmp_path / "out")).video("cam")
    np.testing.assert_array_equal(next(exact_values.read(video.path)), grey)
