"""Two arms touch the same points: where is the second base? And when nobody can tell."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import surg_core
from surg_cli.commands import calibrate
from surg_cli.host import paths
from surg_cli.host.terminal import CliError
from surg_core import base_calibration, base_file
from surg_core.base_calibration import BasesFit, solve_bases

SEEDS = 200


def rotation(rng: np.random.Generator) -> np.ndarray:
    R: np.ndarray = surg_core.quaternion_xyzw_to_matrix(rng.normal(size=4))
    return R


def case(seed: int, noise: float = 0.0, n: int = 8) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A pose of the second base, and n points in both bases."""
    rng = np.random.default_rng(seed)
    X_B1B2 = surg_core.make_pose(rng.uniform(-1.5, 1.5, 3), rotation(rng))
    p_B2 = rng.uniform(-0.1, 0.1, (n, 3)) + rng.uniform(-0.5, 0.5, 3)
    p_B1 = p_B2 @ X_B1B2[:3, :3].T + X_B1B2[:3, 3]
    return X_B1B2, p_B1 + rng.normal(scale=noise or 1e-300, size=(n, 3)), p_B2


def test_exact_points_give_the_exact_base() -> None:
    worst = 0.0
    for seed in range(SEEDS):
        X_B1B2, p_B1, p_B2 = case(seed)
        fit = solve_bases(p_B1, p_B2)
        worst = max(worst, float(np.abs(fit.X_B1B2 - X_B1B2).max()))
        assert fit.n == 8 and fit.rms < 1e-12 and fit.condition >= 1.0
    print(f"{SEEDS} bases: {worst:.1e}")
    assert worst < 1e-12


def test_noise_gives_the_error_that_statistics_expects_and_never_a_reflection() -> None:
    """Against the residual's expectation: 3 n - 6 of 3 n degrees of freedom remain."""
    residuals, errors = [], []
    for seed in range(SEEDS):
        X_B1B2, p_B1, p_B2 = case(seed, noise=0.0003, n=12)
        fit = solve_bases(p_B1, p_B2)
        assert np.linalg.det(fit.X_B1B2[:3, :3]) == pytest.approx(1.0)
        residuals.append(fit.rms**2)
        centre = np.append(p_B2.mean(axis=0), 1.0)
        errors.append(np.linalg.norm((fit.X_B1B2 - X_B1B2) @ centre))
    expected = 0.0003 * np.sqrt(3 - 6 / 12)
    print(f"rms {1e3 * np.sqrt(np.mean(residuals)):.3f} mm, expected {1e3 * expected:.3f} mm")
    assert np.sqrt(np.mean(residuals)) == pytest.approx(expected, rel=0.03)
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(0.0003 * np.sqrt(3 / 12), rel=0.1)


def swapped(p: np.ndarray) -> np.ndarray:
    return p[[1, 0, *range(2, len(p))]]


def flat(p: np.ndarray) -> np.ndarray:
    return p * [1.0, 1.0, 0.0]


@pytest.mark.parametrize(
    ("first", "second", "words"),
    [
        (lambda p: p[:5], lambda p: p[:5], "5 points; at least 6"),
        (lambda p: p[:7], lambda p: p, "7 points of the first arm, 8 of the second"),
        (flat, flat, "of one plane"),
        (lambda p: p * [1, 0, 0], lambda p: p * [1, 0, 0], "of one plane"),
        (lambda p: p, swapped, "remain"),
        (lambda p: p * [1.0, 1.0, -1.0], lambda p: p, "remain"),
        (lambda p: p * 1.05, lambda p: p, "remain"),
        (lambda p: p + np.array([np.nan, 0, 0]), lambda p: p, "not finite"),
    ],
)
def test_points_that_do_not_determine_it_are_refused(
    first: Callable[..., np.ndarray], second: Callable[..., np.ndarray], words: str
) -> None:
    p = np.random.default_rng(2).uniform(-0.1, 0.1, (8, 3))
    with pytest.raises(surg_core.CalibrationError, match=words):
        solve_bases(first(p), second(p))


def recording(path: Path, arm: surg_core.Arm, points: np.ndarray) -> Path:
    """Flange poses whose tips touch the points, each with another orientation."""
    rng = np.random.default_rng(9)
    lines = ["motion,x,y,z,qx,qy,qz,qw"]
    for point in points:
        R = rotation(rng)
        pose = [*(point - R @ arm.tool.p_FTip), *surg_core.matrix_to_quaternion_xyzw(R)]
        lines.append(",".join(["touch", *(repr(float(value)) for value in pose)]))
    path.write_text("\n".join(lines) + "\n")
    return path


def test_the_command_prints_the_base_and_writes_it(
    surg: Callable[..., int],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    folder = tmp_path / "cells" / "two"
    shutil.copytree(paths.CELLS / "sim_two_arms", folder)
    text = (folder / "cell.yaml").read_text()
    (folder / "cell.yaml").write_text(text.replace("../../src", str(paths.ROOT / "src")))
    cell = surg_core.load_cell(folder)
    first, second = cell.arms.values()
    X_B1B2 = surg_core.inverse_pose(first.X_WB) @ second.X_WB
    X_B1B2[:3, 3] += [0.001, 0.0, 0.002]  # the cell's statement is 2.2 mm wrong
    p_B2 = np.random.default_rng(1).uniform(-0.1, 0.1, (7, 3)) + np.array([0.4, 0.0, 0.2])
    files = [
        recording(tmp_path / "a.csv", first, p_B2 @ X_B1B2[:3, :3].T + X_B1B2[:3, 3]),
        recording(tmp_path / "b.csv", second, p_B2),
    ]
    words = ["calibrate", str(folder), "bases", "--from", *files]
    monkeypatch.setattr(calibrate, "today", lambda: "2026-11-23")
    assert surg(*map(str, words)) == 0
    assert "n 7" in capsys.readouterr().out
    found = base_file.load_base(folder / "calibration" / f"base_{second.name}.yaml")
    np.testing.assert_allclose(found.X_WB, first.X_WB @ X_B1B2, atol=1e-9)
    kind = found.evidence.n, found.evidence.date, found.evidence.source, found.method
    assert kind == (7, "2026-11-23", "simulated", "points")
    believed = surg_core.load_cell(folder).arms[second.name]
    np.testing.assert_array_equal(believed.X_WB, found.X_WB)
    np.testing.assert_array_equal(believed.X_WB_stated, second.X_WB_stated)
    with pytest.raises(CliError, match="keeps its base"):
        surg(*map(str, words), "--arm", first.name)
    with pytest.raises(CliError, match="--from FILE FILE"):
        surg(*map(str, words[:-1]))
    with pytest.raises(CliError, match="one arm"):
        surg("calibrate", "sim_ur5e", "bases", "--from", str(files[0]))


def test_a_fit_says_how_good_it_is() -> None:
    _, p_B1, p_B2 = case(3, noise=0.0002)
    fit: BasesFit = solve_bases(p_B1, p_B2)
    away = np.linalg.norm(p_B1 - (p_B2 @ fit.X_B1B2[:3, :3].T + fit.X_B1B2[:3, 3]), axis=1)
    assert fit.worst == pytest.approx(away.max())
    assert fit.worst_point == int(away.argmax()) + 1


def test_the_stated_covariance_is_that_of_repeated_touches() -> None:
    """300 recordings of the same 8 points, each touched with an error of its own."""
    rng = np.random.default_rng(11)
    X, sigma = surg_core.make_pose([0.6, -0.2, 0.1], rotation(rng)), 0.0002
    p_B2 = rng.uniform(-0.06, 0.06, (8, 3)) + np.array([0.4, 0.1, 0.2])
    p_B1 = p_B2 @ X[:3, :3].T + X[:3, 3]
    within = 0
    for _ in range(300):
        fit = solve_bases(p_B1 + rng.normal(0.0, sigma, p_B1.shape), p_B2)
        theta = Rotation.from_matrix(X[:3, :3] @ fit.X_B1B2[:3, :3].T).as_rotvec()
        error = np.concatenate([theta, X[:3, 3] - fit.X_B1B2[:3, 3]])
        within += bool((np.abs(error) < 2.5 * np.sqrt(np.diag(fit.covariance))).all())
    print(f"within 2.5 sigma on all six axes: {within} of 300")
    assert 240 <= within < 300  # about 95 % for the axes' correlations, and few points
    R = rotation(rng)
    moved = base_calibration.in_axes(fit.covariance, R)
    np.testing.assert_allclose(moved[:3, 3:], R @ fit.covariance[:3, 3:] @ R.T, atol=1e-15)
