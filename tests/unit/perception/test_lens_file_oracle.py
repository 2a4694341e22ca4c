"""ROS's own readers read the lens files as they were meant.

They are Debian's `python3-camera-calibration-parsers` and `libcamera-info-manager-dev`, unpacked
into the test's folder. The latter is what a camera driver of ROS starts with a `file://` address.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import helpers
from helpers.graph.ros import RosGraph
from helpers.sim.board_views import BOARD, scope_cell
from helpers.sim.calibrated_chain import ORIGIN, Chain
from surg_core.transforms import FloatArray
from surg_perception.calibration.result_files import LEFT, RIGHT, save_stereo
from surg_perception.calibration.triangulation import Rectified

pytestmark = pytest.mark.oracle

PACKAGES = ("python3-camera-calibration-parsers", "libcamera-calibration-parsers0d")
MANAGER = (
    "libcamera-info-manager-dev",
    "libcamera-info-manager0d",
    "libcamera-calibration-parsers0d",
)
SOURCE = Path(helpers.__file__).parent / "perception" / "camera_info_manager.cpp"
READ = """
import json, sys
from camera_calibration_parsers import readCalibration
name, info = readCalibration(sys.argv[1])
print(json.dumps([name, info.width, info.height, info.distortion_model, list(info.D),
                  list(info.K), list(info.R), list(info.P)]))
"""


def unpacked(folder: Path, packages: Sequence[str]) -> Path:
    """The `usr` of these Debian packages, which are not installed."""
    if shutil.which("apt-get") is None:
        pytest.skip("the reader is a Debian package: apt-get is missing")
    done = subprocess.run(["apt-get", "download", *packages], cwd=folder, capture_output=True)
    if done.returncode:
        pytest.skip(f"{', '.join(packages)}: cannot be downloaded")
    for package in folder.glob("*.deb"):
        subprocess.run(["dpkg", "-x", package, folder / "root"], check=True)
    return folder / "root" / "usr"


def written(calibration: Path) -> list[tuple[Path, tuple[FloatArray, ...]]]:
    """Both lens files as `./surg calibrate CELL stereo` writes them, and what was solved."""
    calibration.mkdir()
    result = Chain(0, scope_cell()).stereo()
    save_stereo(calibration, result, BOARD, "", ORIGIN)
    eyes, rectified = result.stereo, Rectified.of(result.stereo)
    left = (eyes.left.D, eyes.left.K, rectified.R_left, rectified.P[0])
    right = (eyes.right.D, eyes.right.K, rectified.R_right, rectified.P[1])
    return [(calibration / LEFT, left), (calibration / RIGHT, right)]


def compare(
    file: Path,
    size: tuple[int, int],
    model: str,
    found: Sequence[Sequence[float]],
    solved: Sequence[FloatArray],
) -> None:
    """D, K, R, P as a reader states them against those that were solved."""
    assert (*size, model) == (640, 480, "plumb_bob")
    for values, meant in zip(found, solved, strict=True):
        np.testing.assert_allclose(values, meant.ravel(), rtol=0.0, atol=1e-9)
    assert (found[3][3] < 0.0) == (file.name == RIGHT)


def test_the_standards_own_reader_reads_the_lens_files(tmp_path: Path) -> None:
    lib = unpacked(tmp_path, PACKAGES) / "lib"
    env = dict(os.environ, LD_LIBRARY_PATH=str(next(lib.glob("*-linux-gnu"))))
    paths = [str(lib / "python3" / "dist-packages"), env.get("PYTHONPATH", "")]
    env["PYTHONPATH"] = os.pathsep.join(path for path in paths if path)
    for file, solved in written(tmp_path / "calibration"):
        words = ["/usr/bin/python3", "-c", READ, file]
        said = subprocess.run(words, env=env, capture_output=True, text=True)
        assert said.returncode == 0, said.stderr
        name, width, height, model, *matrices = json.loads(said.stdout)
        assert name == file.stem
        compare(file, (width, height), model, matrices, solved)


@pytest.mark.ros
def test_a_camera_info_manager_publishes_the_lens_files(
    tmp_path: Path, ros_graph: RosGraph
) -> None:
    usr, made = unpacked(tmp_path, MANAGER), tmp_path / "manager"
    lib = next((usr / "lib").glob("*-linux-gnu"))
    links = ["-lroscpp", "-lrosconsole", "-lroscpp_serialization", "-lrostime", "-lboost_thread"]
    words = ["c++", "-std=c++17", f"-I{usr / 'include'}", str(SOURCE), "-o", str(made)]
    words += [str(lib / "libcamera_info_manager.so.0d"), f"-Wl,-rpath-link,{lib}", *links]
    subprocess.run(words, check=True)
    env = {**ros_graph.env, "LD_LIBRARY_PATH": str(lib)}
    for file, solved in written(tmp_path / "calibration"):
        words = [str(made), file.stem, f"file://{file}"]
        said = subprocess.run(words, env=env, capture_output=True, text=True, timeout=60)
        assert said.returncode == 0, said.stderr
        first, *rows = said.stdout.splitlines()[-5:]  # before them roscpp logs
        calibrated, width, height, model = first.split()
        assert calibrated == "1" and "does not match" not in said.stderr, said.stderr
        matrices = [[float(word) for word in row.split()] for row in rows]
        compare(file, (int(width), int(height)), model, matrices, solved)
