"""Bags and data sets become episodes, and their motion keeps its numbers."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import rosbag
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import Header

from helpers.foreign.foreign_sources import HZ, START_NS, tip
from helpers.recording import datasets_synthetic, picture_identity
from helpers.recording.picture_identity import Identity
from surg_cli.commands.episode import import_recordings
from surg_cli.host.terminal import CliError
from surg_recording import datasets, episode, metrics
from surg_recording.datasets import ExportOptions
from surg_recording.imports import bag_map
from surg_recording.imports.bag_import import import_bag
from surg_recording.imports.lerobot_reader import import_episode
from surg_recording.imports.lerobot_set import LeRobotData
from surg_recording.nodes.ros_messages_node import ros_time
from surg_recording.recording_errors import EpisodeError
from surg_recording.reports import evaluation
from surg_recording.reports.run_summary import PATH_CUTOFF_HZ
from surg_recording.video import video_file

SAMPLES = 400


def dvrk_bag(path: Path, prefix: str = "/PSM1") -> Path:
    """A bag as dVRK's console records one."""
    with rosbag.Bag(str(path), "w") as bag:
        for n in range(SAMPLES):
            ns = START_NS + n * 10_000_000
            header = Header(stamp=ros_time(ns), frame_id="PSM1_base")
            pose = Pose(Point(*tip(n / HZ)), Quaternion(1, 0, 0, 0))
            bag.write(f"{prefix}/measured_cp", PoseStamped(header, pose), ros_time(ns + 500_000))
            joints = [0.1, 0.2, 0.12, 0.01 * n, 0.0, 0.0]
            state = JointState(header=header, position=joints, velocity=[0.0] * 6)
            bag.write(f"{prefix}/measured_js", state, ros_time(ns + 500_000))
            goal = PoseStamped(header, Pose(Point(*tip(n / HZ + 0.01)), Quaternion(1, 0, 0, 0)))
            bag.write(f"{prefix}/setpoint_cp", goal, ros_time(ns + 500_000))
            jaw = JointState(header=header, position=[0.3])
            bag.write(f"{prefix}/jaw/measured_js", jaw, ros_time(ns + 500_000))
            if n % 5 == 0:
                shown = picture_identity.draw(Identity(9, 0, n // 5))
                height, width = shown.shape[:2]
                image = Image(header, height, width, "rgb8", 0, 3 * width, shown.tobytes())
                bag.write("/jhu_daVinci/left/image_raw", image, ros_time(ns + 700_000))
    return path


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return dvrk_bag(tmp_path_factory.mktemp("bag") / "knot.bag")


def test_a_bag_of_dvrk_becomes_an_episode_to_evaluate(bag: Path, tmp_path: Path) -> None:
    folder = import_bag(bag, tmp_path / "knot")
    recorded = episode.read(folder)
    assert recorded.complete, recorded.manifest["reason"]
    cycle = recorded.cycle("PSM1")
    times = np.arange(SAMPLES) / HZ
    expected = np.array([tip(t) for t in times])
    np.testing.assert_array_equal(cycle.vector("p_tip"), expected)
    np.testing.assert_array_equal(cycle["stamp_ns"], START_NS + np.arange(SAMPLES) * 10_000_000)
    np.testing.assert_allclose(cycle.joints("q")[:, 3], 0.01 * np.arange(SAMPLES))
    entry = evaluation.measure(recorded)
    fs = float(HZ)
    _, path = metrics.uniform(times, expected, fs)
    length = metrics.path_length(path, fs, PATH_CUTOFF_HZ) * 1e3
    assert entry["path_length_mm"]["executed"] == pytest.approx(length, rel=1e-9)
    found = entry["smoothness"]["presets"]["reference"]
    smooth = metrics.smoothness(path, fs, "reference")
    assert found["sparc"] == pytest.approx(smooth.sparc, rel=1e-9)
    assert found["ldlj"] == pytest.approx(smooth.ldlj, rel=1e-9)
    assert entry["rcm_kinematic_mm"] is None, "no bag says where the shaft was"
    assert (entry["source"], entry["robot"]) == ("real", "dvrk_psm")
    video = recorded.video("jhu_daVinci_left")
    images = video_file.grab(video.path, [0, 40, 79])
    assert [picture_identity.read(image).frame for image in images] == [0, 40, 79]


def test_an_imported_bag_can_be_exported(bag: Path, tmp_path: Path) -> None:
    folder = import_bag(bag, tmp_path / "knot")
    options = ExportOptions(executor="serial", splits={"train": 1.0})
    report = datasets.load("lerobot").write([folder], tmp_path / "set", options)
    assert report.ok, report
    table = pq.read_table(tmp_path / "set/data/chunk-000/episode_000000.parquet")
    state = np.array(table.column("observation.state").to_pylist())
    grid = np.array(table.column("timing.grid_ns").to_pylist()) - START_NS
    expected = np.array([tip(t * 1e-9) for t in grid]) * [1, -1, -1]
    np.testing.assert_allclose(state[:, :3], expected, atol=1e-7)


def test_a_map_names_topics_arms_and_facts(tmp_path: Path) -> None:
    path = dvrk_bag(tmp_path / "other.bag", "/left_hand")
    with pytest.raises(EpisodeError, match=r"no topic /PSM1/measured_cp; there are /jhu"):
        import_bag(path, tmp_path / "a")
    stated: dict[str, Any] = {
        "arms": {"PSM2": {"measured_cp": "/left_hand/measured_cp", "rcm": [0, 0, 0.01]}},
        "task": "knot tying",
        "setting": "phantom",
    }
    folder = import_bag(path, tmp_path / "b", bag_map.of_yaml(stated))
    recorded = episode.read(folder)
    assert recorded.arms == ["PSM2"] and recorded.cameras == []
    assert recorded.manifest["task"] == "knot tying"
    np.testing.assert_array_equal(recorded.cycle("PSM2").vector("p_rcm")[0], [0, 0, 0.01])
    stated["arms"]["PSM2"]["jaw"] = "/nowhere"
    with pytest.raises(EpisodeError, match="no topic /nowhere"):
        import_bag(path, tmp_path / "c", bag_map.of_yaml(stated))


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        (None, "'arms' is needed"),
        ({"arms": {"PSM1": {"jaw": "/x"}}}, "arms.PSM1: .*'measured_cp' is needed"),
        ({"arms": {"PSM1": {"measured_cp": "/x", "rcm": [1, 2]}}}, r"arms.PSM1.rcm: \[1, 2\]"),
        ({"arms": {"PSM1": {"measured_cp": "/x"}}, "arm": 1}, "keys are arms"),
    ],
)
def test_a_wrong_map_is_named(stated: Any, said: str) -> None:
    with pytest.raises(EpisodeError, match=said):
        bag_map.of_yaml(stated)


@pytest.mark.parametrize("content", [b"", b"#ROSBAG V2.0\n", b"nonsense" * 100])
def test_what_is_no_bag_is_refused_by_name(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "broken.bag"
    path.write_bytes(content)
    with pytest.raises(EpisodeError, match=r"broken\.bag"):
        import_bag(path, tmp_path / "out")


# --- data sets ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    root = tmp_path_factory.mktemp("sets")
    record = datasets_synthetic.record
    recordings = [record(root / "a", 1, 2.2), record(root / "b", 2, 1.6, success=False)]
    options = ExportOptions(executor="serial", splits={"train": 1.0})
    for name in ("lerobot_v21", "lerobot_v30"):
        assert datasets.load(name).write(recordings, root / name, options).ok
    return {name: root / name for name in ("lerobot_v21", "lerobot_v30")}


@pytest.mark.parametrize(
    "version", [pytest.param("lerobot_v21", marks=pytest.mark.full), "lerobot_v30"]
)
def test_a_data_set_becomes_episodes_with_the_same_metrics(
    version: str, sets: dict[str, Path], tmp_path: Path
) -> None:
    data = LeRobotData(sets[version])
    whole = pq.read_table(sorted((sets[version] / "data").rglob("*.parquet")))
    for index, identity in enumerate((1, 2)):
        folder = import_episode(data, index, tmp_path / str(index))
        recorded = episode.read(folder)
        assert recorded.complete, recorded.manifest["reason"]
        here = np.array(whole.column("episode_index").to_pylist()) == index
        state = np.array(whole.column("observation.state").to_pylist())[here].astype(float)
        grid = np.array(whole.column("timing.grid_ns").to_pylist())[here]
        np.testing.assert_array_equal(recorded.cycle("PSM1").vector("p_tip"), state[:, :3])
        np.testing.assert_array_equal(recorded.cycle("PSM1")["stamp_ns"], grid)
        entry = evaluation.measure(recorded)
        _, path = metrics.uniform((grid - grid[0]) * 1e-9, state[:, :3], 20.0)
        length = metrics.path_length(path, 20.0, PATH_CUTOFF_HZ) * 1e3
        assert entry["path_length_mm"]["executed"] == pytest.approx(length, rel=1e-9)
        for preset in ("reference", "paper"):
            smooth = metrics.smoothness(path, 20.0, preset)
            found = entry["smoothness"]["presets"][preset]
            assert found["sparc"] == pytest.approx(smooth.sparc, rel=1e-9, nan_ok=True)
            assert found["ldlj"] == pytest.approx(smooth.ldlj, rel=1e-9, nan_ok=True)
        assert entry["success"] is (index == 0)
        assert recorded.manifest["run"]["instruction"] == "follow the path"
        for camera, name in enumerate(("endoscope_left", "endoscope_right")):
            video = recorded.video(name)
            assert len(video.frames) == len(grid)
            (shown,) = video_file.grab(video.path, [7])
            seen = picture_identity.read(shown)
            assert (seen.recording, seen.camera) == (identity, camera)
            assert seen.frame == grid[7] // datasets_synthetic.FRAME_NS


def test_a_data_set_of_others_needs_a_map(sets: dict[str, Path], tmp_path: Path) -> None:
    root = tmp_path / "foreign"
    (root / "meta").mkdir(parents=True)
    for name in ("data", "meta/episodes.jsonl"):
        (root / name).symlink_to(sets["lerobot_v21"] / name)
    info = json.loads((sets["lerobot_v21"] / "meta/info.json").read_text())
    info["features"] = {
        name: {**feature, "names": [f"m{i}" for i in range(feature["shape"][0])]}
        for name, feature in info["features"].items()
        if feature["dtype"] != "video"
    }
    (root / "meta/info.json").write_text(json.dumps(info))
    data = LeRobotData(root)
    with pytest.raises(EpisodeError, match="no columns such as PSM1/tip_x"):
        import_episode(data, 0, tmp_path / "a")
    measured = {"x": "m0", "y": 1, "z": "m2", "jaw": 4}
    stated = {"arms": {"PSM1": {"measured": measured, "robot": "other"}}, "setting": "phantom"}
    recorded = episode.read(import_episode(data, 0, tmp_path / "b", stated))
    table = pq.read_table(root / "data/chunk-000/episode_000000.parquet")
    state = np.array(table.column("observation.state").to_pylist())
    np.testing.assert_array_equal(recorded.cycle("PSM1").vector("p_tip"), state[:, :3])
    assert evaluation.measure(recorded)["setting"] == "phantom"
    measured["x"] = "m99"
    with pytest.raises(EpisodeError, match=r"arms.PSM1.measured.x: 'm99' is not in observation"):
        import_episode(data, 0, tmp_path / "c", stated)


def test_the_command_imports_what_it_can(bag: Path, tmp_path: Path) -> None:
    parser = argparse.ArgumentParser()
    import_recordings.add_arguments(parser, "import")
    broken = tmp_path / "broken.bag"
    broken.write_bytes(b"no")
    words = ["rosbag", str(bag), str(broken), "--out", str(tmp_path / "out")]
    assert import_recordings.main(parser.parse_args(words), "import") == 1
    assert [path.name for path in (tmp_path / "out").iterdir() if path.is_dir()] == ["knot"]
    with pytest.raises(CliError, match="no LeRobot data set"):
        words = ["lerobot", str(tmp_path), "--out", str(tmp_path / "out")]
        import_recordings.main(parser.parse_args(words), "import")
