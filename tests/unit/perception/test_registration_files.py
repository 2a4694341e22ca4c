"""The files of a calibrated endoscope: what is written comes back, what is wrong is refused.

Independent readers are PyYAML's safe_load (YAML 1.1, as ROS's Python tools) for the lens files.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from helpers import endoscope_files
from surg_core import ConfigError, base_file, camera_file, lens_file, stereo_file
from surg_core._core import Document
from surg_core.reading.pose_evidence import NO_HASH, file_sha256
from surg_perception.calibration import lens_covariance

SEEDS = 400 if os.environ.get("SURG_TEST_FULL") == "1" else 40


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def write_camera(path: Path, seed: int) -> None:
    found = camera_file.camera_calibration(
        endoscope_files.pose(rng(seed)), endoscope_files.evidence(rng(seed)), "a" * 64, "b" * 64
    )
    camera_file.write_camera(path, found, "a test")


def write_base(path: Path, seed: int) -> None:
    base_file.write_base(
        path, endoscope_files.base(endoscope_files.pose(rng(seed)), "PSM1", seed=seed), "a test"
    )


def write_stereo(path: Path, seed: int) -> None:
    stereo_file.write_stereo(path, endoscope_files.stereo(rng(seed)), "a test")


def write_lens(path: Path, seed: int) -> None:
    lens_file.write_lens(path, endoscope_files.lens("right" if seed % 2 else "left"), "a test")


def write_known(path: Path, seed: int) -> None:
    found = lens_covariance.LensCovariance(known(seed), "a" * 64, "b" * 64)
    lens_covariance.write_lens_covariance(path, found, "a test")


def known(seed: int, m: int = 24) -> np.ndarray:
    """A singular covariance (m, m), as a jackknife over few views gives it."""
    steps = rng(seed).normal(size=(12, m)) * np.logspace(-6, 0, m)
    return np.asarray(steps.T @ steps)


KINDS: dict[str, tuple[Callable[[Path, int], None], Callable[[Path], Any]]] = {
    "camera": (write_camera, camera_file.load_camera),
    "base": (write_base, base_file.load_base),
    "stereo": (write_stereo, stereo_file.load_stereo),
    "lens": (write_lens, lens_file.load_lens),
    "known": (write_known, lens_covariance.load_lens_covariance),
}


def same(a: object, b: object) -> bool:
    if isinstance(a, np.ndarray):
        return np.allclose(a, b, rtol=0.0, atol=1e-15 * max(1.0, float(np.abs(a).max())))
    if hasattr(a, "__dataclass_fields__"):
        return all(same(getattr(a, f), getattr(b, f)) for f in a.__dataclass_fields__)
    return a == b


@pytest.mark.parametrize("seed", range(5))
def test_what_is_written_comes_back(tmp_path: Path, seed: int) -> None:
    r = rng(seed)
    X, evidence = endoscope_files.pose(r), endoscope_files.evidence(r)
    camera = camera_file.camera_calibration(X, evidence, "a" * 64)
    camera_file.write_camera(tmp_path / "c.yaml", camera, "two\nlines")
    assert same(camera, camera_file.load_camera(tmp_path / "c.yaml"))
    assert same(camera.through_lenses, evidence.covariance)
    of_views = 0.25 * evidence.covariance
    camera = camera_file.camera_calibration(X, evidence, "a" * 64, "b" * 64, of_views)
    camera_file.write_camera(tmp_path / "c.yaml", camera, "a test")
    found = camera_file.load_camera(tmp_path / "c.yaml")
    assert same(camera, found) and same(found.through_lenses, of_views)
    base = endoscope_files.base(X, "PSM1", r.uniform(-1, 1, 3), r.uniform(-3, 3, 3))
    base_file.write_base(tmp_path / "b.yaml", base, "a test")
    assert same(base, base_file.load_base(tmp_path / "b.yaml"))
    stereo = endoscope_files.stereo(r)
    stereo_file.write_stereo(tmp_path / "s.yaml", stereo, "a test")
    assert same(stereo, stereo_file.load_stereo(tmp_path / "s.yaml"))
    lens = endoscope_files.lens("right")
    lens_file.write_lens(tmp_path / "l.yaml", lens, "a test")
    assert same(lens, lens_file.load_lens(tmp_path / "l.yaml"))
    for right, m in (("b" * 64, 24), ("b" * 64, 30), (NO_HASH, 9), (NO_HASH, 8)):
        of_lenses = lens_covariance.LensCovariance(known(seed, m), "a" * 64, right)
        lens_covariance.write_lens_covariance(tmp_path / "k.yaml", of_lenses, "a test")
        assert same(of_lenses, lens_covariance.load_lens_covariance(tmp_path / "k.yaml"))


def test_a_lens_file_is_ros_camera_info_for_readers_of_yaml_1_1(tmp_path: Path) -> None:
    write_lens(tmp_path / "l.yaml", 1)
    lens = endoscope_files.lens("right")
    found = yaml.safe_load((tmp_path / "l.yaml").read_text())
    assert (found["image_width"], found["image_height"]) == (640, 480)
    assert found["camera_name"] == "endoscope_right"
    assert found["distortion_coefficients"] == {"rows": 1, "cols": 5, "data": lens.D.tolist()}
    assert found["camera_matrix"] == {"rows": 3, "cols": 3, "data": lens.K.ravel().tolist()}
    assert found["projection_matrix"]["data"] == lens.P.ravel().tolist()
    assert found["rectification_matrix"]["data"] == lens.R.ravel().tolist()


@pytest.mark.parametrize("kind", KINDS)
def test_the_old_file_is_kept_and_a_refused_one_replaces_nothing(
    tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    write, _ = KINDS[kind]
    path = tmp_path / "f.yaml"
    write(path, 0)
    first = path.read_bytes()
    write(path, 1)
    second = path.read_bytes()
    assert first != second
    assert (tmp_path / "f.yaml.previous").read_bytes() == first
    with monkeypatch.context() as patched:
        patched.setattr(endoscope_files, "DATE", "yesterday")
        bad = endoscope_files.lens()
        object.__setattr__(bad, "K", bad.K * math.nan)
        patched.setattr(endoscope_files, "lens", lambda *_: bad)
        patched.setitem(globals(), "known", lambda seed: math.nan * np.eye(24))
        with pytest.raises(ConfigError):
            write(path, 2)
    assert path.read_bytes() == second
    assert sorted(p.name for p in tmp_path.iterdir()) == ["f.yaml", "f.yaml.previous"]


def test_one_eye_has_no_covariance_of_two(tmp_path: Path) -> None:
    path = tmp_path / "f.yaml"
    write_known(path, 1)
    path.write_text(path.read_text().replace(f'"{"b" * 64}"', '"none"'))
    with pytest.raises(ConfigError, match="has 576 numbers; allowed: 64 or 81 or 144 numbers"):
        lens_covariance.load_lens_covariance(path)


@pytest.mark.parametrize("kind", KINDS)
def test_each_key_is_needed_and_no_other_is_taken(tmp_path: Path, kind: str) -> None:
    write, load = KINDS[kind]
    path = tmp_path / "f.yaml"
    write(path, 1)
    whole = yaml.safe_load(path.read_text())
    for key in whole:
        path.write_text(yaml.safe_dump({k: v for k, v in whole.items() if k != key}))
        with pytest.raises(ConfigError, match=rf"f\.yaml: {key}.*: is missing; "):
            load(path)
    path.write_text(yaml.safe_dump({**whole, "residuals": 1.0}))
    with pytest.raises(ConfigError, match=r"f\.yaml:\d+: residuals: is not a known key; "):
        load(path)
    path.write_text(yaml.safe_dump({**whole, "position": {"x": 1.0}}))
    with pytest.raises(ConfigError, match="position"):
        load(path)


BAD_VALUES: list[tuple[str, str, object, str]] = [
    ("camera", "quaternion", [0.0, 0.0, 0.0, 0.9], "length 0.9"),
    ("camera", "quaternion", [math.nan, 0.0, 0.0, 1.0], "holds nan"),
    ("camera", "quaternion", [0.0, 0.0, 1.0], "has 3 numbers"),
    ("camera", "position", [0.0, math.inf, 0.0], "holds inf"),
    ("camera", "position", [0.0, 0.0, 1.6], "allowed: 3 numbers, -1.5 to 1.5 m"),
    ("camera", "position", "here", "'here'"),
    ("camera", "residual", math.nan, "nan; allowed: 0 to 5 px"),
    ("camera", "n", 2, "a whole number, 3 to"),
    ("camera", "n", 12.5, "a whole number"),
    ("camera", "condition", 0.5, "allowed: 1 to"),
    ("camera", "date", "23.11.2026", "'23.11.2026'"),
    ("camera", "date", True, "'True'"),
    ("camera", "source", "guessed", "allowed: measured, simulated"),
    ("camera", "left_sha256", "none", "64 hexadecimal digits"),
    ("camera", "right_sha256", "A" * 64, "or none"),
    ("camera", "format", "surg_camera/3", "allowed: surg_camera/1, surg_camera/2"),
    ("camera", "covariance", [1e-6] * 35, "has 35 numbers"),
    ("camera", "covariance", np.diag([1e-6] * 5 + [0.0]), "holds the variance 0"),
    ("camera", "covariance", np.diag([1e-6] * 5 + [-1e-9]), "holds the variance -1e-09"),
    ("camera", "covariance", np.diag([1e-6] * 5 + [math.nan]), "holds nan"),
    ("camera", "covariance", np.full((6, 6), 1e-6), "eigenvalue"),
    ("camera", "covariance", np.diag([1e-6] * 6) + np.eye(6, k=1) * 1e-7, "not symmetric"),
    ("camera", "covariance", np.diag([0.2, *[1e-6] * 5]), "at most 0.35 rad"),
    ("camera", "covariance", np.diag([*[1e-6] * 5, 0.02]), "at most 0.1 m"),
    ("base", "method", "eye", "allowed: 'touch', 'tip', 'points'"),
    ("base", "n", 5, "allowed is 6 to"),
    ("base", "n", 8.5, "a whole number"),
    ("base", "position", [0.0, 0.0, math.nan], "-10 to 10 m"),
    ("base", "quaternion", [0.0, 0.0, 0.0, 0.9], "length 0.9"),
    ("base", "covariance", np.diag([1e-6] * 5 + [-1e-9]), "holds the variance -1e-09"),
    ("base", "covariance", np.full((6, 6), 1e-6), "eigenvalue"),
    ("base", "covariance", np.diag([1e-6] * 6) + np.eye(6, k=1) * 1e-7, "not symmetric"),
    ("base", "covariance", np.diag([*[1e-6] * 5, 0.02]), "at most 0.1 m"),
    ("base", "camera_sha256", "abc", "64 hexadecimal digits, or none"),
    ("base", "date", "yesterday", "'yesterday'"),
    ("base", "reference", "", "a non-empty text is needed"),
    ("base", "reference_xyz", [0.0, 0.0, 11.0], "-10 to 10 m"),
    ("stereo", "position", [-0.004, 0.0, 0.0], "the eyes are swapped"),
    ("stereo", "position", [0.06, 0.0, 0.0], "is no baseline"),
    ("stereo", "left_sd", [1.0] * 7, "has 7 numbers"),
    ("stereo", "left_sd", [-1.0] * 9, "0 or more"),
    ("stereo", "held_out_px", math.inf, "inf"),
    ("stereo", "lens_state", "", "''"),
    ("known", "covariance", [1e-6] * 25, "has 25 numbers"),
    ("known", "covariance", np.diag([1e-6] * 23 + [math.nan]), "holds nan"),
    ("known", "covariance", np.diag([1e-6] * 23 + [-1e-9]), "holds the variance -1e-09"),
    ("known", "covariance", np.eye(24) + np.eye(24, k=1), "not symmetric"),
    ("known", "covariance", np.eye(24) + np.eye(24, k=1) + np.eye(24, k=-1), "eigenvalue"),
    ("lens", "image_width", 640.5, "a whole number"),
    ("lens", "image_width", 0, "16 to 16384"),
    ("lens", "camera_name", "left eye", "letters, digits"),
    ("lens", "distortion_model", "omni", "plumb_bob, rational_polynomial, equidistant"),
    ("lens", "camera_matrix.data", [0.0] * 9, "is no camera matrix"),
    ("lens", "camera_matrix.data", [math.nan] * 9, "holds nan"),
    ("lens", "camera_matrix.rows", 2, "rows"),
    ("lens", "rectification_matrix.data", [1.0, 0, 0, 0, 1, 0, 0, 0, -1], "is no rotation"),
    ("lens", "projection_matrix.data", [450.0, 0, 320, 0, 0, 450, 240, 2, 0, 0, 1, 0], "fourth"),
    ("lens", "distortion_coefficients.data", [0.0] * 4, "has 4 numbers"),
]


@pytest.mark.parametrize(("kind", "key", "value", "words"), BAD_VALUES)
def test_a_bad_value_is_named_with_what_is_allowed(
    tmp_path: Path, kind: str, key: str, value: object, words: str
) -> None:
    write, load = KINDS[kind]
    path = tmp_path / "f.yaml"
    write(path, 1)
    whole = yaml.safe_load(path.read_text())
    section = whole
    *outer, last = key.split(".")
    for name in outer:
        section = section[name]
    section[last] = value.ravel().tolist() if isinstance(value, np.ndarray) else value
    path.write_text(yaml.safe_dump(whole))
    with pytest.raises(ConfigError) as caught:
        load(path)
    told = str(caught.value)
    assert told.startswith(f"{path}:")
    assert f": {key}: " in told
    assert "allowed" in told or "needed" in told
    assert words in told


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_file_is_refused_or_means_the_same_kind_of_thing(
    tmp_path: Path, kind: str
) -> None:
    """Random damage to the text: only ConfigError, and what is taken stays finite."""
    write, load = KINDS[kind]
    path = tmp_path / "f.yaml"
    write(path, 3)
    whole = path.read_text()
    pieces = ["nan", ".nan", "-", "1e999", "[", "]", ":", "\n", "0", " ", '"', "é", "{}", "\x00"]
    refused = 0
    for seed in range(SEEDS):
        r, text = rng(seed), whole
        for _ in range(int(r.integers(1, 4))):
            at, length = int(r.integers(len(text))), int(r.integers(0, 5))
            text = text[:at] + pieces[r.integers(len(pieces))] + text[at + length :]
        path.write_text(text)
        try:
            found = load(path)
        except ConfigError as error:
            refused += 1
            assert str(path) in str(error)
        else:
            arrays = [v for v in vars(found).values() if isinstance(v, np.ndarray)]
            assert all(np.isfinite(v).all() for v in arrays)
    assert refused > SEEDS // 3, refused


def test_a_lens_for_another_size_is_scaled_only_when_the_aspect_is_equal() -> None:
    lens = endoscope_files.lens("right")
    half = lens.resized(320, 240)
    # A point's pixel, counted from the picture's corner, halves.
    ray = np.array([0.1, -0.2, 1.0])
    for matrix in ("K", "P"):
        big, small = (getattr(each, matrix)[:, :3] @ ray for each in (lens, half))
        assert (small[:2] + 0.5) * 2 == pytest.approx(big[:2] + 0.5)
    assert half.baseline == pytest.approx(0.004)
    assert lens.resized(640, 480) is lens
    with pytest.raises(ConfigError, match="640 x 480, the picture has 640 x 360; allowed: the sa"):
        lens.resized(640, 360)


def test_swapped_or_unlike_eyes_are_refused() -> None:
    left, right = endoscope_files.lens("left"), endoscope_files.lens("right")
    lens_file.check_eyes(left, right, "l.yaml", "r.yaml")
    with pytest.raises(ConfigError, match=r"r\.yaml: projection_matrix.* the eyes are swapped"):
        lens_file.check_eyes(right, left, "l.yaml", "r.yaml")
    mirrored = endoscope_files.lens("right", baseline=-0.004)
    with pytest.raises(ConfigError, match="the eyes are swapped"):
        lens_file.check_eyes(left, mirrored, "l.yaml", "r.yaml")
    with pytest.raises(ConfigError, match="no baseline"):
        lens_file.check_eyes(left, left, "l.yaml", "r.yaml")
    other = endoscope_files.lens("right", 1280, 720)
    with pytest.raises(ConfigError, match=r"r\.yaml: image_width.*1280 x 720; allowed: 640 x 480"):
        lens_file.check_eyes(left, other, "l.yaml", "r.yaml")


def test_files_that_were_not_measured_together_are_refused(tmp_path: Path) -> None:
    endoscope_files.write_endoscope(tmp_path, "ECM")
    stereo, left, right, camera = (
        tmp_path / f"{name}.yaml"
        for name in ("endoscope_stereo", "endoscope_left", "endoscope_right", "camera_ECM")
    )

    def check() -> None:
        found = stereo_file.load_stereo(stereo)
        stereo_file.check_lenses(found, stereo, left, right)

    def check_camera() -> None:
        found = camera_file.load_camera(camera)
        camera_file.check_camera_lenses(found, camera, left, right)

    check()
    check_camera()
    before = file_sha256(right)
    right.write_text(right.read_text() + "# edited\n")
    for checked, file in ((check, stereo), (check_camera, camera)):
        with pytest.raises(ConfigError) as caught:
            checked()
        told = str(caught.value)
        assert told.startswith(f"{file}: right_sha256: {before[:12]}")
        assert str(right) in told
        assert "./surg calibrate CELL" in told
    right.unlink()
    with pytest.raises(ConfigError, match=r"no such file.*handeye"):
        check_camera()


def test_a_single_camera_needs_no_right_lens(tmp_path: Path) -> None:
    endoscope_files.write_endoscope(tmp_path, "ECM", eyes=1)
    file = tmp_path / "camera_ECM.yaml"
    found = camera_file.load_camera(file)
    assert found.right_sha256 == NO_HASH
    camera_file.check_camera_lenses(
        found, file, tmp_path / "endoscope_left.yaml", tmp_path / "endoscope_right.yaml"
    )


ROTATION_ONLY: dict[str, object] = {
    "format": "surg_camera/1",
    "quaternion": [0.0, 0.0, 0.6, 0.8],
    "residual": 0.004,
    "n": 15,
    "date": "2026-11-21",
}


def rotation_only(**change: object) -> camera_file.CameraCalibration:
    values = {k: v for k, v in {**ROTATION_ONLY, **change}.items() if v is not None}
    return camera_file.parse_camera(Document("camera.yaml", values, {}))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("quaternion", [0.0, 0.0, 0.0, 2.0]),
        ("quaternion", [0.0, 0.0, 1.0]),
        ("quaternion", "up"),
        ("quaternion", [math.nan, 0.0, 0.0, 1.0]),
        ("residual", 0.06),
        ("residual", -1e-9),
        ("residual", math.nan),
        ("residual", True),
        ("n", 2),
        ("n", 12.5),
        ("n", math.nan),
        ("n", True),
        ("date", "yesterday"),
        ("date", 20261121.5),
        ("residuals", 0.0),
        ("position", [0.0, 0.0, 0.1]),
        *((key, None) for key in ROTATION_ONLY),
    ],
)
def test_a_rotation_without_evidence_is_refused(key: str, value: object) -> None:
    with pytest.raises(ConfigError, match=f"camera.yaml: {key}: .*; allowed: "):
        rotation_only(**{key: value})


def test_a_file_of_the_first_version_states_the_rotation_only() -> None:
    found = rotation_only()
    assert (found.residual, found.n, found.date) == (0.004, 15, "2026-11-21")
    assert pytest.approx(Rotation.from_quat([0, 0, 0.6, 0.8]).as_matrix()) == found.R_FV
    assert found.X_FV is None
    with pytest.raises(ConfigError, match="position: is missing"):
        camera_file.write_camera("camera.yaml", found, "a test")
