"""Hand-eye, bases and the whole chain: errors against what is stated, over seeds."""

from __future__ import annotations

import hashlib
import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import surg_core
from helpers.endoscope_files import copied_cell
from helpers.results.perception_results import PAGE
from helpers.sim.board_views import scope_cell
from helpers.sim.calibrated_chain import BOARD, ORIGIN, Chain
from surg_core.camera_file import load_camera
from surg_core.reading.pose_evidence import file_sha256
from surg_perception.calibration import evidence
from surg_perception.calibration.bases import SeenBase, solve_base
from surg_perception.calibration.chain_steps import chain_error, check, measured_camera
from surg_perception.calibration.handeye import HandEyeFit, solve_handeye
from surg_perception.calibration.lens_covariance import LensCovariance, write_lens_covariance
from surg_perception.calibration.result_files import (
    COVARIANCE,
    read_lens_covariance,
    save_handeye,
    save_stereo,
)
from surg_perception.calibration.small_motions import difference, expected_error, transform
from surg_perception.calibration.stereo import StereoFit

SIGMAS = 2.5
FEW, MANY = 3, 100


@cache
def solved(seed: int) -> tuple[Chain, StereoFit, HandEyeFit, SeenBase, int]:
    """A cell with errors that nobody knows, and what was measured of it."""
    chain = Chain(seed, scope_cell())
    stereo = chain.stereo()
    handeye = chain.handeye(stereo)
    return chain, stereo, *chain.base(stereo, handeye)


def lengths(step: np.ndarray) -> np.ndarray:
    """Rotation [rad] and shift [m] of a step (2,)."""
    return np.array([np.linalg.norm(step[:3]), np.linalg.norm(step[3:])])


def test_handeye_through_the_trocar_is_as_good_as_it_states(full: bool) -> None:
    rows, naive, seeds = [], [], MANY if full else FEW
    for seed in range(seeds):
        chain, _, result, *_ = solved(seed)
        evidence.check_handeye(result)
        error = lengths(difference(result.X_FV, chain.bench.X_FV))
        rows.append(np.concatenate([error, error / result.pose_error]))
        corners = expected_error(result.fit.covariance_of_corners[:6, :6])
        naive.append(error / corners)
    turn, shift, *_ = np.array(rows).T
    inside = int((np.array(rows)[:, 2:] < SIGMAS).all(axis=1).sum())
    by_corners = int((np.array(naive) < SIGMAS).all(axis=1).sum())
    PAGE.note(
        "hand-eye through the trocar, 15 views",
        seeds,
        f"median {1e3 * np.median(shift):.3f} mm, {np.degrees(np.median(turn)):.3f}°, largest "
        f"{1e3 * shift.max():.3f} mm, {np.degrees(turn.max()):.3f}°; inside 2.5 sigma in {inside}, "
        f"with a covariance over corners in {by_corners}",
    )
    assert np.median(shift) <= 3e-4 and np.median(turn) <= np.radians(0.1)
    assert shift.max() <= 3e-4 and turn.max() <= np.radians(0.1)
    assert inside >= 0.95 * seeds
    assert by_corners < 0.5 * seeds


def test_with_exact_joints_the_lens_is_in_what_handeye_states(full: bool) -> None:
    """Nothing but the lens errs then, alike in every view: no jackknife over views shows it."""
    rows, of_views, seeds = [], [], 40 if full else FEW
    for seed in range(seeds):
        chain = Chain(seed, scope_cell())
        chain.bench.encoder = 0.0
        result = chain.handeye(chain.stereo())
        error = lengths(difference(result.X_FV, chain.bench.X_FV))
        rows.append(error / result.pose_error)
        of_views.append(error / expected_error(result.fit.covariance[:6, :6]))
    inside, without = (int((np.array(r) < SIGMAS).all(axis=1).sum()) for r in (rows, of_views))
    PAGE.note(
        "hand-eye with exact joints, 15 views",
        seeds,
        f"inside 2.5 sigma in {inside}, without the lens's share in {without}",
    )
    assert inside >= 0.95 * seeds
    assert without <= 0.5 * seeds


@pytest.mark.full
def test_an_error_of_the_lens_cancels_in_what_is_seen_through_it() -> None:
    """It turns and shifts the eye; touched corners, seen through the same lens, stay."""
    rng, moved_eye, moved_base = np.random.default_rng(3), [], []

    def measured(step: np.ndarray) -> tuple[np.ndarray, SeenBase]:
        chain = Chain(0, scope_cell())
        chain.bench.encoder = 0.0
        stereo = chain.stereo()
        solution = stereo.fit.solution
        solution = replace(solution, stereo=solution.stereo.moved(step))
        stereo = replace(stereo, fit=replace(stereo.fit, solution=solution))
        handeye = chain.handeye(stereo)
        return handeye.X_FV, chain.touch(stereo, handeye)

    covariance = Chain(0, scope_cell()).stereo().fit.covariance
    values, axes = np.linalg.eigh(covariance)
    X_FV, base = measured(np.zeros(len(values)))
    for _ in range(4):
        step = axes @ (np.sqrt(np.maximum(values, 0.0)) * rng.normal(size=len(values)))
        X, other = measured(step)
        moved_eye.append(lengths(difference(X, X_FV)))
        amid = surg_core.inverse_pose(base.X_ST) @ np.append(base.middle, 1.0)
        shift = np.linalg.norm(((other.X_ST - base.X_ST) @ amid)[:3])
        moved_base.append([lengths(difference(other.X_ST, base.X_ST))[0], shift])
    eye, seen = np.mean(moved_eye, axis=0), np.mean(moved_base, axis=0)
    print(f"by the lens: eye {np.degrees(eye[0]):.3f} deg, {1e3 * eye[1]:.3f} mm; base "
          f"{np.degrees(seen[0]):.4f} deg, {1e3 * seen[1]:.4f} mm")  # fmt: skip
    assert seen[0] < 0.5 * eye[0] and seen[1] < 0.25 * eye[1]


def test_the_lens_files_state_how_well_the_lenses_are_known(tmp_path: Path) -> None:
    _, stereo, *_ = solved(0)
    assert read_lens_covariance(tmp_path) is None
    save_stereo(tmp_path, stereo, BOARD, "", ORIGIN)
    known = read_lens_covariance(tmp_path)
    assert known is not None
    np.testing.assert_allclose(known, stereo.fit.covariance, rtol=1e-12, atol=0.0)
    kept = (tmp_path / COVARIANCE).read_bytes()
    hashes = [file_sha256(tmp_path / f"endoscope_{eye}.yaml") for eye in ("left", "right")]
    write_lens_covariance(tmp_path / COVARIANCE, LensCovariance(np.eye(30), *hashes), "")
    with pytest.raises(surg_core.ConfigError, match="is 30 x 30; allowed: 24 x 24"):
        read_lens_covariance(tmp_path)
    save_stereo(tmp_path, solved(1)[1], BOARD, "", ORIGIN)
    (tmp_path / COVARIANCE).write_bytes(kept)
    with pytest.raises(surg_core.ConfigError, match=r"left_sha256.*or delete this file"):
        read_lens_covariance(tmp_path)
    (tmp_path / "endoscope_right.yaml").unlink()
    with pytest.raises(surg_core.ConfigError, match=r"right_sha256: .* allowed: .*else none"):
        read_lens_covariance(tmp_path)


def test_the_stated_error_of_a_baseline_holds(full: bool) -> None:
    rows, seeds = [], MANY if full else FEW
    for seed in range(seeds):
        result, true = solved(seed)[1], np.eye(4)
        true[0, 3] = 0.004
        rows.append(lengths(difference(result.stereo.X_LR, true)) / result.pose_error)
    inside = int((np.array(rows) < SIGMAS).all(axis=1).sum())
    PAGE.note("stereo pose, 20 views", seeds, f"inside 2.5 sigma in {inside}")
    assert inside >= 0.95 * seeds


def test_a_base_by_touch_is_as_good_as_it_states(full: bool) -> None:
    rows, repeated, seeds = [], 0, MANY if full else FEW
    for seed in range(seeds):
        chain, _, _, result, refused = solved(seed)
        repeated += refused > 0
        true = surg_core.inverse_pose(chain.X_W_ECM) @ chain.cell.arms["PSM1"].X_WB_stated
        amid = surg_core.inverse_pose(result.X_ST) @ np.append(result.middle, 1.0)
        turn = np.linalg.norm(difference(result.X_ST, true)[:3])
        shift = np.linalg.norm((true @ amid)[:3] - result.middle)
        rows.append([turn, shift, turn / result.error[0], shift / result.error[1]])
    turn, shift, *_ = np.array(rows).T
    inside = int((np.array(rows)[:, 2:] < SIGMAS).all(axis=1).sum())
    PAGE.note(
        "base by touch, 32 touches of 0.1 mm",
        seeds,
        f"median {1e3 * np.median(shift):.3f} mm, {np.degrees(np.median(turn)):.3f}°, largest "
        f"{1e3 * shift.max():.3f} mm, {np.degrees(turn.max()):.3f}°; inside 2.5 sigma in {inside}; "
        f"{repeated} refused at first",
    )
    assert shift.max() <= 5e-4
    assert turn.max() <= np.radians(0.2)
    assert inside >= 0.95 * seeds


def test_a_base_by_tip_has_the_right_turn() -> None:
    """The place that is followed lies up the shaft; the turn does not mind."""
    chain, stereo, handeye, *_ = solved(0)
    rng, scope, tool = np.random.default_rng(5), chain.bench.scope, chain.bench.tool
    X_SV = scope.X_home @ chain.bench.X_FV
    X_TS = surg_core.inverse_pose(tool.arm.X_WB_stated) @ chain.X_W_ECM
    p_S, p_T = [], []
    for _ in range(12):
        p_V = np.append(rng.uniform(-0.018, 0.018, 2), rng.uniform(0.065, 0.1))
        q = chain.bench._touching(tool, (X_TS @ X_SV @ np.append(p_V, 1.0))[:3])
        X = tool.arm.chain.forward(q)
        up = X_SV[:3, :3].T @ X_TS[:3, :3].T @ X[:3, :3] @ tool.s_F
        followed = (p_V - 0.004 * up)[None]
        left = chain.bench.eyes[0].project(followed)
        right = chain.bench.eyes[1].project(chain.bench._right(followed))
        noise = rng.normal(scale=0.15, size=(2, 1, 2))
        seen = stereo.stereo.triangulate(left + noise[0], right + noise[1])
        p_S.append(transform(scope.X_home @ handeye.X_FV, seen)[0])
        p_T.append(chain.tip(q))
    X_SF = np.repeat(scope.X_home[None], 12, axis=0)
    result = solve_base(np.array(p_S), np.array(p_T), X_SF, handeye.X_FV, handeye.of_views)
    evidence.check_tip(result, np.array(p_S))
    turn = np.degrees(lengths(difference(result.X_ST, surg_core.inverse_pose(X_TS)))[0])
    print(f"by tip, 12 rests: turn {turn:.2f} deg off, stated {np.degrees(result.error[0]):.2f}")
    assert turn <= 2.0


def test_check_states_the_error_of_the_whole_chain(full: bool, tmp_path: Path) -> None:
    folder, found = copied_cell(tmp_path), []
    seeds = MANY if full else 2
    fresh = folder.with_name("fresh")
    shutil.copytree(folder, fresh)
    for seed in range(seeds):
        chain = Chain(seed, surg_core.load_cell(fresh))
        chain.write(folder / "calibration")
        believed = surg_core.load_cell(folder)
        stated = chain_error(believed).two_sigma
        camera, _ = measured_camera(believed)
        before = chain.disagreement(
            replace(chain.cell, folder=folder), np.asarray(measured_in_urdf(chain.cell))
        )
        after = chain.disagreement(believed, np.asarray(camera.X_FV))
        found.append([before, after, stated])
    before, after, stated = 1e3 * np.array(found).T
    inside = int((after <= stated).sum())
    PAGE.note(
        "whole chain, joints against picture at 80 mm",
        seeds,
        f"before {np.median(before):.1f} mm, after {np.median(after):.2f} mm (median), stated "
        f"{np.median(stated):.2f} mm (2 sigma), inside in {inside}",
    )
    assert inside >= 0.95 * seeds
    assert np.median(after) <= 1.0 and np.median(before) >= 5.0 * np.median(after)
    assert "joints and picture agree within" in check(believed)[-1]


def measured_in_urdf(cell: surg_core.Cell) -> np.ndarray:
    """The eye in the flange as the instrument's drawing states it (4, 4)."""
    arm = cell.arms["ECM"]
    frame = arm.instrument.camera.frames[0]
    return surg_core.fixed_transform(arm.instrument_urdf, arm.instrument.mount_link, frame)


def test_handeye_with_a_wrong_lens_is_refused() -> None:
    chain, stereo, good, *_ = solved(1)
    wrong = stereo.fit.solution.stereo
    step = np.zeros(2 * len(wrong.left.values) + 6)
    step[[0, 1]] = step[[9, 10]] = 0.01 * wrong.left.values[0]
    step[[2, 11]] = 2.0
    solution = replace(stereo.fit.solution, stereo=wrong.moved(step))
    bad = chain.handeye(replace(stereo, fit=replace(stereo.fit, solution=solution)))
    away = lengths(difference(bad.X_FV, chain.bench.X_FV))
    print(f"wrong lens: rms {good.fit.rms:.3f} -> {bad.fit.rms:.3f} px, off {1e3 * away[1]:.2f} mm")
    assert bad.fit.rms < evidence.LARGEST_RMS  # the residuals alone do not show it
    evidence.check_handeye(good)
    with pytest.raises(evidence.Refused) as refused:
        evidence.check_handeye(bad)
    assert any(reason.startswith("focal length") for reason in refused.value.reasons)


def test_a_board_printed_too_small_is_refused() -> None:
    chain, stereo, *_ = solved(2)
    views = list(chain.bench.moved_scope(12))
    X_BF = np.array([chain.cell.arms["ECM"].chain.forward(v.joints["ECM"]) for v in views])
    seen = [
        tuple(replace(eye, p_Board=eye.p_Board / 0.97) for eye in pair)
        for pair in chain.seen(views)
    ]
    with pytest.raises(evidence.Refused) as refused:
        evidence.check_handeye(solve_handeye(stereo.stereo, X_BF, seen))  # type: ignore[arg-type]
    assert any(reason.startswith("board size") for reason in refused.value.reasons)


def test_a_new_lens_file_makes_the_camera_stale(tmp_path: Path) -> None:
    folder = copied_cell(tmp_path)
    cell, calibration = surg_core.load_cell(folder), folder / "calibration"
    _, stereo, handeye, *_ = solved(0)
    save_stereo(calibration, stereo, BOARD, "", ORIGIN)
    camera = load_camera(save_handeye(calibration, "ECM", handeye, ORIGIN))
    for eye, stated in (("left", camera.left_sha256), ("right", camera.right_sha256)):
        file = calibration / f"endoscope_{eye}.yaml"
        assert stated == hashlib.sha256(file.read_bytes()).hexdigest(), eye
    measured_camera(cell)
    save_stereo(calibration, solved(1)[1], BOARD, "", ORIGIN)
    with pytest.raises(surg_core.ConfigError, match="left_sha256"):
        measured_camera(cell)
    assert check(cell)[-1].startswith("next: ")
