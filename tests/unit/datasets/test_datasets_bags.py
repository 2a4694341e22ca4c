"""Bags and MCAP files, read back by rosbag and by the messages' own classes."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from std_msgs.msg import String

from helpers.recording import datasets_synthetic, felt_forces, picture_identity
from helpers.recording.bag_messages import FORMATS, read
from helpers.recording.datasets_synthetic import FRAME_NS
from helpers.recording.picture_identity import Identity
from helpers.recording.recording_synthetic import Synthetic, path
from helpers.tree import oracle_venv
from surg_core.contract import POSITION_STREAMS
from surg_recording import datasets
from surg_recording.datasets import ExportOptions
from surg_recording.episode import episode_reader
from surg_recording.nodes.ros_messages_node import Stamped
from surg_recording.recording_errors import EpisodeError

OPTIONS = ExportOptions(executor="serial", splits={"train": 1.0})
SECONDS = 0.6
FORCES = {"tip": "/PSM1/tool/measured_cf", "trocar": "/PSM1/trocar/measured_cf"}


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bags") / "episode"
    return datasets_synthetic.record(folder, 3, SECONDS, felt=True)


@pytest.mark.parametrize("format_name", FORMATS)
def test_every_message_says_what_was_recorded(
    format_name: str, recording: Path, tmp_path: Path
) -> None:
    out = tmp_path / "set"
    report = datasets.load(format_name).write([recording], out, OPTIONS)
    assert report.ok, report
    (file,) = out.glob("episode_000000*")
    what, found, last = Synthetic(seconds=SECONDS), {}, 0
    for topic, message, time_ns in read(format_name, file):
        found.setdefault(topic, []).append((time_ns, message))
        assert time_ns >= last
        last = time_ns
    cycle = episode_reader.read(recording).cycle("PSM1")
    obeyed = dict(zip(cycle["stamp_ns"], cycle["command"], strict=True))
    for time_ns, message in found["/PSM1/setpoint_cp"]:
        p = message.pose.position
        streams = obeyed[time_ns] in POSITION_STREAMS
        expected = (path if streams else what.executed)(time_ns * 1e-9)
        np.testing.assert_allclose([p.x, p.y, p.z], expected, atol=1e-7)
        assert message.header.frame_id == "PSM1_rcm"
        assert message.header.stamp.to_nsec() == time_ns
    commands = [m for t, m in found["/PSM1/servo_cp"] if t * 1e-9 < 0.1 + SECONDS]
    for message in commands:
        p, t = message.pose.position, message.header.stamp.to_sec()
        np.testing.assert_allclose([p.x, p.y, p.z], path(t), atol=1e-7)
    for camera, side in enumerate(("left", "right")):
        for time_ns, message in found[f"/endoscope/{side}/image_raw/compressed"]:
            image = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_COLOR)
            assert picture_identity.read(image) == Identity(3, camera, time_ns // FRAME_NS)
    forces = {place: found.pop(topic) for place, topic in FORCES.items()}
    times = [time_ns for time_ns, _ in found["/PSM1/measured_cp"]]
    for first, place in ((0, "tip"), (4, "trocar")):
        rows = {t: felt_forces.expected(t)[first : first + 4] for t in times}
        known = [t for t in times if rows[t][3]]
        assert [time_ns for time_ns, _ in forces[place]] == known, "only where it is known"
        for time_ns, message in forces[place]:
            f = message.wrench.force
            np.testing.assert_allclose([f.x, f.y, f.z], rows[time_ns][:3], atol=1e-6)
            assert message.header.frame_id == "PSM1_rcm"
            assert message.header.stamp.to_nsec() == time_ns
    assert 0 < len(forces["tip"]) < len(forces["trocar"]) == report.frames
    counts = {len(each) for topic, each in found.items() if topic.startswith(("/PSM1", "/endo"))}
    assert counts == {report.frames}
    ((_, words),) = found["/instruction"]
    assert words.data == "follow the path"
    assert datasets.check(out, datasets.load(format_name)).ok


def test_a_damaged_mcap_is_noticed(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "set"
    exporter = datasets.load("mcap")
    assert exporter.write([recording], out, OPTIONS).ok
    (file,) = out.glob("*.mcap")
    data = bytearray(file.read_bytes())
    for place, cut in ((len(data) // 3, None), (None, len(data) // 2), (None, 4)):
        spoiled = bytearray(data)
        if place is not None:
            spoiled[place] ^= 0x40
        file.write_bytes(spoiled[:cut])
        with pytest.raises(EpisodeError, match=r"\.mcap: "):
            list(exporter.read_file(file))
        assert exporter.validate(out).errors


def test_messages_need_absolute_actions(recording: Path, tmp_path: Path) -> None:
    options = ExportOptions(executor="serial", action_space="velocity")
    with pytest.raises(datasets.ExportError, match="--action-space absolute only"):
        datasets.load("rosbag").write([recording], tmp_path / "set", options)


def test_an_mcap_file_has_an_index_of_every_chunk(tmp_path: Path) -> None:
    def stamped() -> Iterator[Stamped]:
        for n in range(3000):
            yield Stamped(10 * n, f"/t{n % 2}", String("a" * 1000))

    file = tmp_path / "recording.mcap"
    datasets.load("mcap").write_file(file, stamped(), {"a": "b"})
    with open(file, "rb") as opened:
        summary = make_reader(opened, validate_crcs=True).get_summary()
    assert summary is not None and summary.statistics is not None
    assert len(summary.chunk_indexes) == summary.statistics.chunk_count == 3
    assert summary.statistics.message_count == 3000


@pytest.mark.oracle
def test_the_mcap_library_reads_every_message(recording: Path, tmp_path: Path) -> None:
    installs = [("mcap==1.6.0", "mcap-ros1-support==0.9.0")]
    python = oracle_venv.python("mcap", installs, ("mcap", "mcap_ros1"))
    report = datasets.load("mcap").write([recording], tmp_path / "set", OPTIONS)
    (file,) = (tmp_path / "set").glob("*.mcap")
    script = Path(datasets_synthetic.__file__).with_name("mcap_reader.py")
    done = subprocess.run([python, script, file], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads(done.stdout)
    assert found["profile"] == "ros1"
    assert found["messages"] == found["straight"] == sum(found["counts"].values())
    assert found["chunks"] == found["indexed"] >= 1
    assert found["metadata"]["recording"]["instruction"] == "follow the path"
    assert found["counts"]["/endoscope/left/image_raw/compressed"] == report.frames
    what = Synthetic(seconds=SECONDS)
    for time_ns, *p in found["setpoints"]:
        np.testing.assert_allclose(p, what.executed(time_ns * 1e-9), atol=1e-7)
    print(f"mcap {found['mcap']}: {found['messages']} messages, {found['chunks']} chunks")
