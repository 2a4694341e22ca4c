"""Bags of ROS 2: those that ``rosbags-convert`` makes of ROS 1, and those of our own export."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rosbag
import yaml
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Header

from crtk_msgs.msg import OperatingState
from helpers.foreign.foreign_sources import PERIOD_NS, START_NS, samples, twin, write_bag
from helpers.recording import datasets_synthetic
from surg_recording import datasets, episode
from surg_recording.datasets import ExportOptions
from surg_recording.imports.bag_import import import_bag
from surg_recording.imports.ledger import Ledger
from surg_recording.nodes.ros_messages_node import Stamped, ros_time
from surg_recording.recording_errors import EpisodeError

COUNT = 120


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag of ROS 1: late messages, Bayer and JPEG pictures, types that only CRTK knows."""
    import cv2

    grey = np.tile(np.arange(64, dtype=np.uint8), (48, 1))
    jpeg = cv2.imencode(".jpg", cv2.merge([grey, grey, grey]))[1].tobytes()

    def further(opened: rosbag.Bag) -> None:
        for n in range(20):
            ns = START_NS + 5 * n * PERIOD_NS
            header, seen = Header(n, ros_time(ns), "cam"), ros_time(ns + 700_000)
            raw = Image(header, 48, 64, "bayer_rggb8", 0, 64, (grey + n).tobytes())
            opened.write("/cam/image_raw", raw, seen)
            coded = CompressedImage(header, "jpeg", jpeg)
            opened.write("/jpeg/image_raw/compressed", coded, seen)
            opened.write("/PSM1/operating_state", OperatingState(header=header), seen)

    messages = samples(COUNT)
    for each in messages[::5]:
        each.received_ns += 4 * PERIOD_NS
    messages.sort(key=lambda each: each.received_ns)
    return write_bag(tmp_path_factory.mktemp("ros1") / "knot.bag", messages, further=further)


def hashes(folder: Path) -> dict[str, str]:
    """Of every file that the recorder made, but the manifest, which names the source."""
    files = sorted(file for file in folder.rglob("*") if file.is_file())
    return {
        str(file.relative_to(folder)): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in files
        if file.name != "manifest.json"
    }


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_bag_and_its_twin_give_the_same_episode(bag: Path, storage: str, tmp_path: Path) -> None:
    """The folder of MCAP, and of SQLite 3 the one file in it."""
    other = twin(bag, tmp_path, storage, "--compress", "zstd")
    told = []
    for path in (bag, other if storage == "mcap" else other / "knot.db3"):
        ledger = Ledger()
        folder = import_bag(path, tmp_path / f"out_{path.suffix}", ledger=ledger)
        manifest = episode.read(folder).manifest["imported"]
        source = {manifest.pop("format"), manifest.pop("from")}
        assert len(source) == 2
        told.append((hashes(folder), manifest, ledger.stated()))
    assert told[0] == told[1]
    assert len(told[0][0]) > 4 and told[0][2]["kept"]["/PSM1/measured_cp"] == COUNT


@pytest.mark.full
def test_exports_of_both_kinds_are_imported_alike(tmp_path: Path) -> None:
    recording = datasets_synthetic.record(tmp_path / "episode", 3, 0.6)
    options = ExportOptions(executor="serial", splits={"train": 1.0})
    found = []
    for name in ("rosbag", "rosbag2", "rosbag2_sqlite3"):
        out = tmp_path / name
        assert datasets.load(name).write([recording], out, options).ok
        (path,) = out.glob("episode_*")
        found.append(hashes(import_bag(path, tmp_path / f"again_{name}")))
        with AnyReader([path]) as reader:
            assert all(each.msgdef.data for each in reader.connections)
    assert found[0] == found[1] == found[2]


def test_a_bag_defines_the_types_that_only_crtk_knows(tmp_path: Path) -> None:
    state = OperatingState(header=Header(stamp=ros_time(START_NS)), state="ENABLED")
    for name in ("rosbag2", "rosbag2_sqlite3"):
        path = tmp_path / name
        datasets.load(name).write_file(path, [Stamped(START_NS, "/PSM1/state", state)], {"a": "b"})
        with AnyReader([path]) as reader:
            ((connection, time_ns, data),) = reader.messages()
            message: Any = reader.deserialize(data, connection.msgtype)
        assert (time_ns, message.state) == (START_NS, "ENABLED")
        assert message.header.stamp.nanosec + message.header.stamp.sec * 10**9 == START_NS


def refuse(path: Path, said: str, out: Path) -> None:
    with pytest.raises(EpisodeError, match=said):
        import_bag(path, out)
    assert not list(out.parent.glob(f"{out.name}*"))


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_damaged_bag_is_refused_by_name(bag: Path, storage: str, tmp_path: Path) -> None:
    whole = twin(bag, tmp_path, storage)
    (file,) = (each for each in whole.iterdir() if each.suffix != ".yaml")
    content = file.read_bytes()
    for share in (0.0, 0.1, 0.5, 0.95):
        file.write_bytes(content[: int(share * len(content))])
        refuse(whole, "not a bag that can be read", tmp_path / "out")
    file.unlink()
    refuse(whole, r"missing: .*knot", tmp_path / "out")


def test_the_metadata_cannot_name_a_file_elsewhere(bag: Path, tmp_path: Path) -> None:
    whole = twin(bag, tmp_path, "mcap")
    shutil.move(whole / "knot.mcap", tmp_path / "knot.mcap")
    stated = yaml.safe_load((whole / "metadata.yaml").read_text())
    about = stated["rosbag2_bagfile_information"]
    for place in ("../knot.mcap", str(tmp_path / "knot.mcap")):
        about["relative_file_paths"] = [place]
        (whole / "metadata.yaml").write_text(yaml.safe_dump(stated))
        refuse(whole, "missing", tmp_path / "out")
    about["version"] = 99
    (whole / "metadata.yaml").write_text(yaml.safe_dump(stated))
    refuse(whole, "version 99 not supported", tmp_path / "out")
