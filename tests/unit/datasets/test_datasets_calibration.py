"""A data set says through which lens it looks and from where: lenses, hand-eye, bases, poses.

A scope that follows the instrument is recorded with measured files. MuJoCo's own camera and tip are
the oracle of what is drawn into the exported video.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import roslib.message

import surg_core
from helpers import endoscope_files
from helpers.recording import drawn_tip, oracle_reading
from helpers.tree import oracle_venv
from surg_core import base_file
from surg_core.contract import TICK_NS
from surg_core.held_endoscope import held_endoscope
from surg_core.transforms import inverse_pose, make_pose
from surg_recording import datasets
from surg_recording.calibration import calibration_record
from surg_recording.episode import episode_reader
from surg_recording.recording_errors import EpisodeError

ARM, SCOPE = "PSM1", "ECM"
FILES = ("endoscope_left", "endoscope_right", "endoscope_stereo", "camera_ECM", "base_ECM")
EYES = ("left", "right")
CAMERAS = ("endoscope_left", "endoscope_right")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[int, np.ndarray]]:
    """An episode of 3.2 s, and where the true tip is in both pictures at each stamp [px]."""
    from surg_sim.appearance.opengl import NoOpenGL
    from surg_sim.envs.recorded_episode import RecordedSession
    from surg_sim.physics import endoscope_rig
    from surg_sim.physics.endoscope_projection import EndoscopeView
    from surg_sim.tasks.endoscope_guidance.endoscope_guidance_task import EndoscopeGuidance

    width, height = 320, 240
    root = tmp_path_factory.mktemp("calibrated")
    cell = endoscope_files.copied_cell(root)
    measure(cell)
    truth: dict[int, np.ndarray] = {}

    class Watched(RecordedSession):
        """Notes what MuJoCo says before each tick."""

        def tick(self, *args: Any, **keys: Any) -> Any:
            data, model = self.world.data, self.world.model
            tip = data.xpos[model.body(f"{ARM}_tip").id]
            eyes = (endoscope_rig.LEFT, endoscope_rig.RIGHT)
            uv = [EndoscopeView(model, data, eye).project(tip)[0] for eye in eyes]
            centre = np.array([(width - 1) / 2, (height - 1) / 2])
            truth[self.world.tick * TICK_NS] = height * np.array(uv) + centre
            return super().tick(*args, **keys)

    before = EndoscopeGuidance.time_limit
    EndoscopeGuidance.time_limit = 3.2
    try:
        session = Watched(cell, "endoscope_guidance", cameras=EYES, size=(width, height))
        session.record(root / "episode", 7)
        session.close()
    except NoOpenGL as error:
        pytest.skip(str(error))
    finally:
        EndoscopeGuidance.time_limit = before
    return root / "episode", truth


def measure(folder: Path) -> None:
    """Files as a good calibration would leave them: they state what is built."""
    cell = surg_core.load_cell(folder)
    arm, first = cell.arms[SCOPE], cell.config.arms[0]
    calibration = folder / "calibration"
    endoscope_files.write_endoscope(calibration, SCOPE, held_endoscope(cell).X_FV)
    stated = endoscope_files.base(arm.X_WB_stated, ARM, first.base_xyz, first.base_rpy)
    base_file.write_base(calibration / f"base_{SCOPE}.yaml", stated, "a test")


@pytest.fixture(scope="module")
def exported(
    recorded: tuple[Path, dict[int, np.ndarray]], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    out = tmp_path_factory.mktemp("export") / "dataset"
    options = datasets.ExportOptions(fps=20, splits={"train": 1.0})
    report = datasets.load("lerobot").write([recorded[0]], out, options)
    assert report.ok, [*report.errors, *report.refused.values()]
    assert datasets.load("lerobot").validate(out).ok
    return out


def test_the_manifest_carries_the_files_their_hashes_and_the_lenses(
    recorded: tuple[Path, dict[int, np.ndarray]],
) -> None:
    manifest = episode_reader.read(recorded[0]).manifest
    cell, folder = manifest["cell"], recorded[0].parent / "sim_two_arms"
    assert cell["problems"] == []
    for name in FILES:
        path = f"calibration/{name}.yaml"
        data = (folder / path).read_bytes()
        assert cell["calibration"][path].encode() == data
        assert cell["files"][path] == hashlib.sha256(data).hexdigest()
    assert cell["arms"][SCOPE]["camera_calibration"]["format"] == "surg_camera/2"
    assert cell["arms"][SCOPE]["base_calibration"]["reference"] == ARM
    models = manifest["camera_info"]
    assert set(models) == set(CAMERAS)
    assert (models["endoscope_right"]["width"], models["endoscope_right"]["height"]) == (320, 240)
    assert models["endoscope_right"]["P"][3] == pytest.approx(
        -0.004 * models["endoscope_right"]["P"][0]
    )


def test_the_drawn_tip_is_the_true_one(
    recorded: tuple[Path, dict[int, np.ndarray]], exported: Path
) -> None:
    """In every frame, in both eyes, through a scope that moves."""
    from pyarrow import parquet

    truth = recorded[1]
    table = parquet.read_table(next((exported / "data").rglob("*.parquet")))
    stamps = table["timing.grid_ns"].to_pylist()
    poses = np.array(table["observation.camera_pose"].to_pylist())
    assert np.ptp(poses[:, :3], axis=0).max() > 0.0005, "the scope does not move"
    worst = []
    for eye, feature in enumerate(drawn_tip.EYES):
        pixels = drawn_tip.tip_pixels(exported, ARM, feature)
        wanted = np.array([truth[stamp][eye] for stamp in stamps])
        worst.append(float(np.linalg.norm(pixels - wanted, axis=1).max()))
    print(f"{len(stamps)} frames, worst {worst[0]:.2f} and {worst[1]:.2f} px of 320 x 240")
    assert max(worst) <= 2.0


def test_the_lenses_of_smaller_pictures_are_those_of_the_pictures(
    recorded: tuple[Path, dict[int, np.ndarray]], tmp_path: Path
) -> None:
    """Half as wide and a third as high: MuJoCo's tip in the recorded pictures, scaled."""
    from pyarrow import parquet

    out = tmp_path / "dataset"
    options = datasets.ExportOptions(fps=20, size=(160, 80), cameras=CAMERAS[1:])
    assert datasets.load("lerobot").write([recorded[0]], out, options).ok
    stamps = parquet.read_table(next((out / "data").rglob("*.parquet")))["timing.grid_ns"]
    truth = np.array([recorded[1][stamp][1] for stamp in stamps.to_pylist()])
    wanted = (truth + 0.5) * (1 / 2, 1 / 3) - 0.5
    pixels = drawn_tip.tip_pixels(out, ARM, "observation.images.endoscope.right")
    off = float(np.linalg.norm(pixels - wanted, axis=1).max())
    print(f"{len(pixels)} frames of 160 x 80, at most {off:.3f} px off")
    assert off <= 1.0
    index = json.loads((out / "meta/calibration/index.json").read_text())
    model = index["sets"][0]["camera_info"]["endoscope_right"]
    assert (model["width"], model["height"]) == (160, 80)
    assert model["P"][3] == pytest.approx(-0.004 * model["P"][0])


@pytest.mark.parametrize("broken", [[1.0], "focal", ["f"] * 9, None])
def test_a_camera_model_that_cannot_be_resized_is_named(broken: object) -> None:
    model = {"width": 320, "height": 240, "K": broken, "P": [0.0] * 12}
    manifest = {"camera_info": {"endoscope_left": model}}
    with pytest.raises(EpisodeError, match=r"camera_info\.endoscope_left"):
        calibration_record.of_manifest("manifest.json", manifest, (160, 120))


def test_the_data_set_has_the_files_as_they_were(
    recorded: tuple[Path, dict[int, np.ndarray]], exported: Path
) -> None:
    folder, meta = recorded[0].parent / "sim_two_arms/calibration", exported / "meta"
    for name in FILES:
        copy = meta / f"calibration/0/{name}.yaml"
        assert copy.read_bytes() == (folder / f"{name}.yaml").read_bytes()
    index = json.loads((meta / "calibration/index.json").read_text())
    assert index["episodes"] == [0]
    assert (
        index["sets"][0]["files"]["camera_ECM.yaml"]
        == hashlib.sha256((folder / "camera_ECM.yaml").read_bytes()).hexdigest()
    )
    page = (meta / "README.md").read_text()
    assert "meta/calibration/" in page
    assert "observation.camera_pose" in page


def test_an_edited_calibration_is_found(exported: Path, tmp_path: Path) -> None:
    shutil.copytree(exported, tmp_path / "copy")
    file = tmp_path / "copy/meta/calibration/0/base_ECM.yaml"
    file.write_text(file.read_text().replace("touch", "tip"))
    errors = datasets.load("lerobot").validate(tmp_path / "copy").errors
    assert any("base_ECM.yaml" in error for error in errors)


def test_a_manifest_with_an_edited_calibration_is_refused(
    recorded: tuple[Path, dict[int, np.ndarray]],
) -> None:
    manifest = json.loads((recorded[0] / "manifest.json").read_text())
    place = "calibration/camera_ECM.yaml"
    good = manifest["cell"]["calibration"][place]
    for path, text in ((place, good + "#"), ("../../etc/x.yaml", good), (place, "")):
        manifest["cell"]["calibration"] = {path: text}
        with pytest.raises(EpisodeError, match="the manifest was edited"):
            calibration_record.of_manifest("manifest.json", manifest)
    manifest["cell"]["endoscope"]["X_FV"] = [[1.0]]
    with pytest.raises(EpisodeError, match=r"cell\.endoscope"):
        calibration_record.endoscope_of("manifest.json", manifest)


@pytest.mark.parametrize("format_name", ["mcap", "rosbag"])
def test_bags_carry_lenses_poses_and_files(
    recorded: tuple[Path, dict[int, np.ndarray]], tmp_path: Path, format_name: str
) -> None:
    """The tip drawn by the messages alone: camera_info, the camera's pose, the arm's pose."""
    out = tmp_path / "set"
    options = datasets.ExportOptions(fps=20, executor="serial", size=(160, 120))
    report = datasets.load(format_name).write([recorded[0]], out, options)
    assert report.ok, [*report.errors, *report.refused.values()]
    file = next(path for path in out.iterdir() if path.stem == "episode_000000")
    found = by_topic(file)
    calibration = json.loads((out / "calibration/index.json").read_text())["sets"][0]
    for name, other in ((f"/{ARM}/measured_cp", f"{ARM}_base"), ("/endoscope/left/pose", "world")):
        assert {m.header.frame_id for m in found[name].values()} == {other}
    worst = 0.0
    for time_ns, picture in found["/endoscope/left/image_raw/compressed"].items():
        info = found["/endoscope/left/camera_info"][time_ns]
        assert info.header == picture.header
        assert (info.width, info.height) == (160, 120)
        camera = found["/endoscope/left/pose"][time_ns].pose
        p, q = camera.position, camera.orientation
        tip = found[f"/{ARM}/measured_cp"][time_ns].pose.position
        seven, p_BTip = [p.x, p.y, p.z, q.x, q.y, q.z, q.w], [tip.x, tip.y, tip.z]
        model = {key: getattr(info, key) for key in ("K", "D", "distortion_model")}
        pixel = left_pixel(seven, p_BTip, calibration, model)
        wanted = (recorded[1][time_ns][0] + 0.5) / 2 - 0.5
        worst = max(worst, float(np.linalg.norm(pixel - wanted)))
    print(f"{format_name}: {report.frames} frames of 160 x 120, at most {worst:.3f} px off")
    assert worst <= 1.0
    assert len(found["/endoscope/right/camera_info"]) == report.frames
    (out / "calibration/0/base_ECM.yaml").unlink()
    assert any("base_ECM" in error for error in datasets.load(format_name).validate(out).errors)


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("version", "format_name"), [("0.3.3", "lerobot"), ("0.4.4", "lerobot_v30")]
)
def test_lerobot_gives_the_camera_s_pose(
    recorded: tuple[Path, dict[int, np.ndarray]], tmp_path: Path, version: str, format_name: str
) -> None:
    """The tip drawn by what lerobot itself gives, in every frame."""
    out = tmp_path / "set"
    options = datasets.ExportOptions(fps=20, splits={"train": 1.0})
    assert datasets.load(format_name).write([recorded[0]], out, options).ok
    calibration = json.loads((out / "meta/calibration/index.json").read_text())["sets"][0]
    _, _, *frames = oracle_reading.run(version, "lerobot_reader.py", out, 1000, 1, home=tmp_path)
    off = []
    for frame in frames:
        model = calibration["camera_info"][CAMERAS[0]]
        pixel = left_pixel(frame["camera_pose"], frame["cartesian"][:3], calibration, model)
        off.append(float(np.linalg.norm(pixel - recorded[1][frame["grid_ns"]][0])))
    print(f"lerobot {version}: {len(off)} frames of 320 x 240, at most {max(off):.2f} px off")
    assert max(off) <= 2.0


def left_pixel(seven: Any, p_BTip: Any, calibration: Any, model: Any) -> np.ndarray:
    """Where the tip is in the left picture [px]; ``seven`` is the pose of the left camera."""
    X_WB = np.array(calibration["endoscope"]["bases"][ARM])
    p_V = inverse_pose(make_pose(seven[:3], seven[3:])) @ X_WB @ [*p_BTip, 1.0]
    return drawn_tip.project(p_V[None, :3], model)[0]


@pytest.mark.oracle
def test_an_mcap_doctor_finds_nothing(
    recorded: tuple[Path, dict[int, np.ndarray]], tmp_path: Path
) -> None:
    """PyPI's pymcap-cli, by others: records, checksums, indices and order of an MCAP file."""
    python = oracle_venv.python("pymcap-cli", [("pymcap-cli==0.34.0",)], ("pymcap_cli",))
    assert datasets.load("mcap").write([recorded[0]], tmp_path / "set", datasets.ExportOptions()).ok
    (file,) = (tmp_path / "set").glob("*.mcap")

    def doctor() -> tuple[int, list[dict[str, Any]]]:
        words = [python.with_name("pymcap-cli"), "doctor", "--strict-message-order"]
        argv = [*words, "--format", "jsonl", file]
        done = subprocess.run(argv, capture_output=True, text=True, check=False)
        return done.returncode, [json.loads(line) for line in done.stdout.splitlines()]

    code, said = doctor()
    print(said)
    assert code == 0
    assert {each.get("severity", "info") for each in said} == {"info"}
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    assert doctor()[0] != 0, "the doctor must find a flipped bit"


def by_topic(file: Path) -> dict[str, dict[int, Any]]:
    """Topic → time [ns] → message of an exported bag or MCAP file."""
    found: dict[str, dict[int, Any]] = {}
    exporter: Any = datasets.load("mcap" if file.suffix == ".mcap" else "rosbag")
    for time_ns, topic, kind, data in exporter.read_file(file):
        message = roslib.message.get_message_class(kind)()
        message.deserialize(data)
        found.setdefault(topic, {})[time_ns] = message
    return found


@pytest.mark.parametrize("format_name", ["act", "robomimic"])
def test_other_formats_carry_it_as_an_attribute(
    recorded: tuple[Path, dict[int, np.ndarray]], tmp_path: Path, format_name: str
) -> None:
    h5py = pytest.importorskip("h5py")
    options = datasets.ExportOptions(fps=20, cameras=())
    report = datasets.load(format_name).write([recorded[0]], tmp_path / "out", options)
    assert report.ok, [*report.errors, *report.refused.values()]
    file = {"act": "episode_0.hdf5", "robomimic": "demos.hdf5"}[format_name]
    with h5py.File(tmp_path / "out" / file, "r") as root:
        attrs = root.attrs if format_name == "act" else root["data/demo_0"].attrs
        found = json.loads(attrs["calibration"])
    assert set(found) == {"files", "camera_info", "endoscope"}
    assert found["files"]["endoscope_left.yaml"].startswith("# made up")
