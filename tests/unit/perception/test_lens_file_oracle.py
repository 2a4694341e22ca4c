"""ROS's own reader, which `camera_info_manager` uses, reads the lens files as they were meant.

The reader is Debian's `python3-camera-calibration-parsers`, unpacked into the test's folder.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from helpers.sim.board_views import BOARD, scope_cell
from helpers.sim.calibrated_chain import ORIGIN, Chain
from surg_core.lens_file import load_lens
from surg_perception.calibration.result_files import save_stereo

pytestmark = pytest.mark.oracle

PACKAGES = ("python3-camera-calibration-parsers", "libcamera-calibration-parsers0d")
READ = """
import json, sys
from camera_calibration_parsers import readCalibration
name, info = readCalibration(sys.argv[1])
print(json.dumps([name, info.width, info.height, info.distortion_model, list(info.D),
                  list(info.K), list(info.R), list(info.P)]))
"""


def reader(folder: Path) -> dict[str, str]:
    """The environment in which Debian's reader runs."""
    if shutil.which("apt-get") is None:
        pytest.skip("the reader is a Debian package: apt-get is missing")
    done = subprocess.run(["apt-get", "download", *PACKAGES], cwd=folder, capture_output=True)
    if done.returncode:
        pytest.skip(f"{', '.join(PACKAGES)}: cannot be downloaded")
    for package in folder.glob("*.deb"):
        subprocess.run(["dpkg", "-x", package, folder / "root"], check=True)
    root = folder / "root" / "usr" / "lib"
    env = dict(os.environ, LD_LIBRARY_PATH=str(next(root.glob("*-linux-gnu"))))
    paths = [str(root / "python3" / "dist-packages"), env.get("PYTHONPATH", "")]
    return env | {"PYTHONPATH": os.pathsep.join(path for path in paths if path)}


def test_the_standards_own_reader_reads_the_lens_files(tmp_path: Path) -> None:
    env, calibration = reader(tmp_path), tmp_path / "calibration"
    calibration.mkdir()
    save_stereo(calibration, Chain(0, scope_cell()).stereo(), BOARD, "", ORIGIN)
    for eye in ("left", "right"):
        file = calibration / f"endoscope_{eye}.yaml"
        words = ["/usr/bin/python3", "-c", READ, file]
        said = subprocess.run(words, env=env, capture_output=True, text=True)
        assert said.returncode == 0, said.stderr
        name, width, height, model, *matrices = json.loads(said.stdout)
        lens = load_lens(file)
        assert (name, width, height, model) == (file.stem, 640, 480, "plumb_bob")
        for found, meant in zip(matrices, (lens.D, lens.K, lens.R, lens.P), strict=True):
            np.testing.assert_allclose(found, meant.ravel(), rtol=0.0, atol=1e-12)
        assert (matrices[3][3] < 0.0) == (eye == "right")
