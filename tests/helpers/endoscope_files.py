"""Calibration files of a made-up endoscope, good ones; tests break them."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np

from surg_cli.host import paths
from surg_core import base_file, camera_file, lens_file, stereo_file
from surg_core.reading.pose_evidence import NO_HASH, Evidence, file_sha256
from surg_core.transforms import make_pose

DATE = "2026-11-23"


def copied_cell(folder: Path, name: str = "sim_two_arms") -> Path:
    """A copy of a bundled cell in which calibration files can be written."""
    copy = folder / name
    shutil.copytree(paths.CELLS / name, copy)
    text = (copy / "cell.yaml").read_text()
    (copy / "cell.yaml").write_text(text.replace("../../src", str(paths.ROOT / "src")))
    return copy


def covariance(rng: np.random.Generator, turn: float = 1e-3, shift: float = 1e-4) -> np.ndarray:
    """A random positive definite matrix (6, 6) with these standard deviations [rad, m]."""
    A = rng.normal(size=(6, 6)) + 2.0 * np.eye(6)
    C = A @ A.T
    sd = np.array([turn] * 3 + [shift] * 3) / np.sqrt(np.diag(C))
    C = C * np.outer(sd, sd)
    return (C + C.T) / 2


def evidence(rng: np.random.Generator, residual: float = 0.1, n: int = 15) -> Evidence:
    """Evidence with a random covariance."""
    return Evidence(covariance(rng), residual, n, 3.5, DATE, "simulated")


def lens(
    side: str = "left", width: int = 640, height: int = 480, baseline: float = 0.004
) -> lens_file.Lens:
    """A lens with some distortion."""
    f, cx, cy = 0.7 * width, width / 2 - 0.7, height / 2 + 1.3
    K = np.array([[f, 0.0, cx], [0.0, f * 1.001, cy], [0.0, 0.0, 1.0]])
    P = np.zeros((3, 4))
    P[:, :3] = K
    P[0, 3] = 0.0 if side == "left" else -f * baseline
    D = np.array([-0.3, 0.1, 1e-5, -2e-4, 0.0])
    return lens_file.Lens(width, height, f"endoscope_{side}", K, "plumb_bob", D, np.eye(3), P)


def pose(rng: np.random.Generator, size: float = 0.3) -> np.ndarray:
    """A random pose (4, 4) within size [m] of the origin."""
    q = rng.normal(size=4)
    return make_pose(rng.uniform(-size, size, 3), q / np.linalg.norm(q))


def write_endoscope(
    folder: Path, arm: str, X_FV: np.ndarray | None = None, seed: int = 0, eyes: int = 2
) -> None:
    """Lens files, stereo file and ``camera_<arm>.yaml`` that belong together."""
    rng = np.random.default_rng(seed)
    sides = ("left", "right")[:eyes]
    files = {side: folder / f"endoscope_{side}.yaml" for side in sides}
    for side, file in files.items():
        lens_file.write_lens(file, lens(side), "made up")
    hashes = [file_sha256(file) for file in files.values()]
    if eyes == 2:
        stereo_file.write_stereo(folder / "endoscope_stereo.yaml", stereo(rng, *hashes), "made up")
    found = camera_file.camera_calibration(
        pose(rng) if X_FV is None else X_FV, evidence(rng), *hashes
    )
    camera_file.write_camera(folder / f"camera_{arm}.yaml", found, "made up")


def stereo(
    rng: np.random.Generator, left: str = "0" * 64, right: str = "1" * 64
) -> stereo_file.StereoCalibration:
    """The pose between the eyes, 4 mm apart."""
    return stereo_file.StereoCalibration(
        X_LR=make_pose([0.004, 1e-5, -2e-5], rng.normal(0.0, 1e-3, 3)),
        evidence=evidence(rng),
        left_sd=rng.uniform(0.0, 1.0, 9),
        right_sd=rng.uniform(0.0, 1.0, 9),
        held_out_px=0.2,
        held_out=np.array([1e-4, 2e-4, 3e-4]),
        lens_state='focus ring at the "mark"',
        board="charuco 11x8, 5 mm",
        left_sha256=left,
        right_sha256=right,
    )


def base(
    X_WB: np.ndarray,
    reference: str,
    xyz: np.ndarray | None = None,
    rpy: np.ndarray | None = None,
    seed: int = 0,
) -> base_file.BaseCalibration:
    """A measured base; xyz, rpy: the stated base of the reference (default: the origin)."""
    rng = np.random.default_rng(seed)
    zero = np.zeros(3)
    stated = zero if xyz is None else xyz, zero if rpy is None else rpy
    found = evidence(rng, 2e-4, 8)
    return base_file.BaseCalibration(X_WB, "touch", found, reference, *stated, NO_HASH)
