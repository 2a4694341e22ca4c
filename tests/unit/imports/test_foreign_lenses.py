"""Lens files as ROS's calibrator, Kalibr and OpenCV write them give OpenCV's own pixels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from surg_core import ConfigError
from surg_core.lens_file import load_lens
from surg_core.pictures.lens_model import LensModel

K = np.array([[500.0, 0.0, 320.0], [0.0, 498.0, 240.0], [0.0, 0.0, 1.0]])
BROWN = [-0.2, 0.05, 0.001, -0.0005, 0.01]
RATIONAL = [*BROWN, 0.02, -0.01, 0.003]
FISHEYE = [0.01, -0.004, 0.001, -0.0002]
POINTS = np.array([[0.1, 0.05, 1.0], [-0.2, 0.1, 0.8], [0.3, -0.25, 1.1], [0.0, 0.0, 1.0]])


def ros_form(D: list[float], model: str, R: Any = None, **changed: Any) -> str:
    """What ``camera_calibration`` and ``camera_info_manager`` write."""
    turn = np.eye(3) if R is None else np.asarray(R)

    def matrix(values: np.ndarray[Any, Any]) -> dict[str, Any]:
        rows, cols = values.shape
        return {"rows": rows, "cols": cols, "data": values.ravel().tolist()}

    stated = {
        "image_width": 640,
        "image_height": 480,
        "camera_name": "narrow_stereo/left",
        "camera_matrix": matrix(K),
        "distortion_model": model,
        "distortion_coefficients": matrix(np.array([D])),
        "rectification_matrix": matrix(turn),
        "projection_matrix": matrix(np.hstack([K, np.zeros((3, 1))])),
        **changed,
    }
    return yaml.safe_dump(stated)


def opencv_form(path: Path, D: list[float], capital: bool = False, fisheye: bool = False) -> str:
    """What OpenCV's own writer makes of it."""
    names = ["image_width", "image_height", "camera_matrix", "distortion_coefficients"]
    if capital:
        names = ["image_Width", "image_Height", "Camera_Matrix", "Distortion_Coefficients"]
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in zip(names, (640, 480, K, np.array([D]).T), strict=True):
        storage.write(name, value)
    if fisheye:
        storage.write("fisheye_model", 1)
    storage.release()
    return path.read_text()


def kalibr_form(D: list[float], model: str, cameras: int = 1) -> str:
    camera = {
        "camera_model": "pinhole",
        "distortion_coeffs": D,
        "distortion_model": model,
        "intrinsics": [500.0, 498.0, 320.0, 240.0],
        "resolution": [640, 480],
        "rostopic": "/cam0/image_raw",
        "T_cn_cnm1": np.eye(4).tolist(),
    }
    return yaml.safe_dump({f"cam{i}": camera for i in range(cameras)})


def expected(D: list[float], fisheye: bool) -> np.ndarray[Any, Any]:
    """OpenCV's pixels."""
    nothing = np.zeros(3)
    project = cv2.fisheye.projectPoints if fisheye else cv2.projectPoints
    pixels, _ = project(POINTS[:, None], nothing, nothing, K, np.array(D))
    return pixels[:, 0]


CASES: dict[str, tuple[list[float], bool]] = {
    "4": (BROWN[:4], False),
    "5": (BROWN, False),
    "8 of plumb_bob": ([*BROWN, 0.0, 0.0, 0.0], False),
    "8": (RATIONAL, False),
    "12": ([*RATIONAL, 0.0, 0.0, 0.0, 0.0], False),
    "14": ([*RATIONAL, *[0.0] * 6], False),
    "14 with three": ([*BROWN, *[0.0] * 9], False),
    "fisheye": (FISHEYE, True),
}


@pytest.mark.parametrize("form", ["ros", "opencv", "opencv capital", "kalibr"])
@pytest.mark.parametrize("case", CASES)
def test_every_form_projects_as_opencv_does(case: str, form: str, tmp_path: Path) -> None:
    D, fisheye = CASES[case]
    file = tmp_path / "lens-1.yaml"
    if form == "ros":
        long = "rational_polynomial" if len(D) > 8 else "plumb_bob"
        file.write_text(ros_form(D, "equidistant" if fisheye else long))
    elif form == "kalibr":
        file.write_text(kalibr_form(D, "equidistant" if fisheye else "radtan"))
    else:
        opencv_form(file, D, capital=form.endswith("capital"), fisheye=fisheye)
    lens = load_lens(file)
    assert (lens.width, lens.height) == (640, 480)
    found = LensModel.of(lens).project(POINTS)
    np.testing.assert_allclose(found, expected(D, fisheye), atol=1e-9)


@pytest.mark.parametrize("decimals", [12, 6, 5, 4])
def test_a_rotation_with_few_decimals_is_made_one(decimals: int, tmp_path: Path) -> None:
    true, _ = cv2.Rodrigues(np.array([0.02, -0.03, 0.01]))
    (tmp_path / "lens.yaml").write_text(ros_form(BROWN, "plumb_bob", true.round(decimals)))
    R = load_lens(tmp_path / "lens.yaml").R
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=2e-6)
    np.testing.assert_allclose(R, true, atol=2 * 10.0**-decimals)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (ros_form([*RATIONAL, 0.1, 0.0, 0.0, 0.0], "rational_polynomial"), "thin prism"),
        (ros_form([*RATIONAL, *[0.0] * 4, 0.1, 0.0], "rational_polynomial"), "CALIB_TILTED_MODEL"),
        (ros_form([0.1] * 7, "plumb_bob"), "7 numbers for plumb_bob; allowed: 4, 5, 8, 12 or 14"),
        (ros_form(BROWN, "equidistant"), "5 numbers for equidistant; allowed: 4"),
        (ros_form(BROWN, "omni"), "'omni'; allowed: plumb_bob"),
        (ros_form(BROWN, "plumb_bob", np.diag([1.0, 0.99, 1.0])), "is no rotation"),
        (ros_form(BROWN, "plumb_bob", np.diag([1.0, 1.0, -1.0])), "is no rotation"),
        (ros_form(BROWN, "plumb_bob", camera_name="a b"), "camera_name: 'a b'"),
        (
            ros_form(
                BROWN,
                "plumb_bob",
                camera_matrix={"rows": 3, "cols": 3, "data": [500, 0.3, 320, 0, 500, 240, 0, 0, 1]},
            ),
            r"has a skew of 0\.3 px.*without skew",
        ),
        (kalibr_form(BROWN[:4], "radtan", cameras=2), "describes 2 cameras"),
        (kalibr_form(BROWN[:4], "radtan").replace("pinhole", "omni"), "allowed: pinhole"),
        ("cam0: {intrinsics: [1, 2]}", "as Kalibr writes them"),
        ("%YAML:1.0\n---\nimage_width: 640\n", "distortion_coefficients is missing"),
        ("%YAML:1.0\n---\n[unclosed", "is not YAML"),
        ('<?xml version="1.0"?>\n<opencv_storage>\n</opencv_storage>\n', "is XML; allowed: YAML"),
    ],
    ids=[str(i) for i in range(15)],
)
def test_what_cannot_be_used_names_the_cure(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "lens.yaml").write_text(text)
    with pytest.raises(ConfigError, match=said):
        load_lens(tmp_path / "lens.yaml")
