"""The tip found in pictures: drawn ones in every run, the simulator's in the full run."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

import surg_core
from helpers.endoscope_files import copied_cell
from helpers.results.perception_results import PAGE
from helpers.sim.board_views import BARREL, BOARD, Array
from helpers.sim.calibrated_chain import ORIGIN
from helpers.sim.unknown_scene import UnknownScene
from surg_core.pictures.lens_model import LensModel
from surg_core.transforms import rotation_of, rotation_vector
from surg_perception.calibration import base_steps, evidence, tip_views
from surg_perception.calibration.board_file import write_board
from surg_perception.calibration.result_files import save_handeye, save_stereo
from surg_perception.calibration.tip_finder import NotSeen, TipScene, find_tip
from surg_perception.calibration.triangulation import Stereo
from surg_perception.calibration.views import View, Views
from surg_sim.physics.patient_settings import PatientSetting
from surg_sim.physics.pose_error import PoseError

WIDTH, HEIGHT = 320, 240
LENS = LensModel(
    "plumb_bob", (WIDTH, HEIGHT), np.array([225.0, 225.0, 161.0, 118.0, -0.2, 0.05, 0.0, 0.0, 0.0])
)
X_LR = np.eye(4)
X_LR[0, 3] = 0.004
EYES = Stereo(LENS, LENS, X_LR)
RADIUS = 0.004
SHAFT = np.array([-0.5, 0.55, 0.67])


class Painter:
    """Draws a flat, textured strip that ends at a tip, before a textured wall."""

    def __init__(self) -> None:
        y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
        pixels = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
        self.rays = EYES.left.rays(pixels)  # both eyes have the same lens
        rng = np.random.default_rng(4)
        self.wall = cv2.GaussianBlur(rng.uniform(60, 150, (200, 200, 3)), (0, 0), 1.5)
        self.metal = cv2.GaussianBlur(rng.uniform(0, 255, (64, 16, 3)), (0, 0), 1.0)
        self.rng = rng

    def draw(self, tip: Array | None, s: Array) -> tuple[Array, Array]:
        """Left and right picture (h, w, 3); None: no instrument."""
        eyes = (self._eye(tip, s, X_LR[:3, 3] * k) for k in (0.0, 1.0))
        left, right = eyes
        return left, right

    def _eye(self, tip: Array | None, s: Array, origin: Array) -> Array:
        wall = origin + (0.13 - origin[2]) * self.rays
        picture = self._texture(self.wall, (wall[:, :2] + 0.1) / 0.2)
        if tip is not None:
            normal = tip / np.linalg.norm(tip)
            normal = normal - (normal @ s) * s
            depth = ((tip - origin) @ normal) / (self.rays @ normal)
            p = origin + depth[:, None] * self.rays - tip
            along, across = -(p @ s), p @ np.cross(s, normal / np.linalg.norm(normal))
            strip = (along >= 0.0) & (np.abs(across) < RADIUS)
            uv = np.column_stack([(across + RADIUS) / (2 * RADIUS), along / 0.03 % 1.0])
            picture[strip] = self._texture(self.metal, uv[strip])
        shape = (HEIGHT, WIDTH, 3)
        noisy = picture.reshape(shape) + self.rng.normal(scale=2.0, size=shape)
        return np.clip(np.round(noisy), 0, 255).astype(np.uint8)

    @staticmethod
    def _texture(texture: Array, uv: Array) -> Array:
        rows, columns = texture.shape[:2]
        at = (uv * [columns - 1, rows - 1]).astype(np.float32)
        wide = texture.astype(np.float32)
        parts = [
            cv2.remap(wide, part[None, :, 0], part[None, :, 1], cv2.INTER_LINEAR)[0]
            for part in np.array_split(at, 1 + len(at) // 20000)
        ]
        return np.concatenate(parts)


def rests(count: int) -> tuple[list[tuple[Array, Array]], Array, Array]:
    """Pictures, true tips (n, 3) and directions of the shaft (n, 3)."""
    painter, rng = Painter(), np.random.default_rng(1)
    tips = np.column_stack(
        [rng.uniform(-0.018, 0.018, (count, 2)), rng.uniform(0.06, 0.095, count)]
    )
    trocar = np.array([0.1, -0.1, -0.04])
    s = (tips - trocar) / np.linalg.norm(tips - trocar, axis=1)[:, None]
    return [painter.draw(tip, each) for tip, each in zip(tips, s, strict=True)], tips, s


@pytest.fixture(scope="module")
def drawn() -> tuple[list[tuple[Array, Array]], Array, Array]:
    return rests(10)


def test_a_drawn_tip_is_found_although_its_direction_is_5_degrees_wrong(
    drawn: tuple[list[tuple[Array, Array]], Array, Array],
) -> None:
    pairs, tips, s = drawn
    scene = TipScene.of([left for left, _ in pairs])
    wrong = s @ rotation_of(np.radians(5.0) * np.array([0.6, 0.0, 0.8])).T
    found = np.array([find_tip(scene, p, EYES, d) for p, d in zip(pairs, wrong, strict=True)])
    away = 1e3 * np.abs(found - tips)
    print(f"x, y, z off: mean {away.mean(axis=0).round(2)}, most {away.max(axis=0).round(2)} mm")
    assert away[:, :2].max() <= 0.8 and away[:, 2].max() <= 1.5
    spread = 1e3 * (found - tips).std(axis=0)
    assert spread.max() <= 0.7


def test_a_tip_that_is_not_seen_is_refused_with_a_cure(
    drawn: tuple[list[tuple[Array, Array]], Array, Array],
) -> None:
    pairs, tips, s = drawn
    painter = Painter()
    empty = painter.draw(None, s[0])[0]
    scene = TipScene.of([left for left, _ in pairs] + [empty] * (len(pairs) + 1))
    with pytest.raises(NotSeen, match="no instrument"):
        find_tip(scene, painter.draw(None, s[0]), EYES, s[0])
    with pytest.raises(NotSeen, match="leaves the picture"):
        find_tip(scene, painter.draw(np.array([-0.03, 0.05, 0.08]), s[0]), EYES, s[0])
    with pytest.raises(NotSeen, match="disagree"):
        find_tip(scene, (pairs[0][0], pairs[0][0][::-1].copy()), EYES, s[0])
    with pytest.raises(NotSeen, match="along the view"):
        find_tip(scene, pairs[0], EYES, tips[0] / np.linalg.norm(tips[0]))


def test_what_does_not_fit_the_other_rests_is_left_out() -> None:
    rng = np.random.default_rng(3)
    p_T = rng.uniform(-0.02, 0.02, (10, 3))
    p_S = p_T @ rotation_of(np.array([0.3, -0.2, 0.1])).T + rng.normal(scale=2e-4, size=(10, 3))
    assert tip_views.fitting(p_S, p_T).all()
    for wrong in ([4], [2, 7]):
        ghosts = p_S.copy()
        ghosts[wrong, 2] += 0.03
        assert np.flatnonzero(~tip_views.fitting(ghosts, p_T)).tolist() == wrong


def test_a_moved_endoscope_and_too_few_rests_are_refused(tmp_path: Path) -> None:
    X = np.repeat(np.eye(4)[None], 9, axis=0)
    views = Views(tmp_path, BOARD, (4, 4), [View("000", 0.0, {}, None, (None, None))] * 9, [])
    for share, refused in ((0.9, False), (1.1, True)):
        moved, turned = X.copy(), X.copy()
        moved[3, 0, 3] = share * tip_views.MOST_SHIFT
        turned[3, :3, :3] = rotation_of(np.array([0.0, share * tip_views.MOST_TURN, 0.0]))
        for X_SF in (moved, turned):
            with pytest.raises(ValueError) as caught:  # without pictures it ends there
                tip_views.seen_tips(views, EYES, X_SF, np.ones((9, 3)))
            assert isinstance(caught.value, evidence.Refused) is refused
    tip_views.enough_tips(views.views[:8], [])
    with pytest.raises(evidence.Refused) as few:
        tip_views.enough_tips(views.views[:7], ["008: hidden"])
    assert "hidden" in few.value.reasons[0]


def scene_of(seed: int, folder: Path) -> UnknownScene:
    """A cell whose second base is 8 mm, 3 deg off, with a measured lens and camera."""
    setting = PatientSetting(
        "unknown",
        base_error=PoseError(0.008, np.radians(3.0), seed=seed + 1),
        camera_error=PoseError(0.003, np.radians(2.0), seed=seed + 50),
        lens=BARREL,
    )
    made = UnknownScene(surg_core.load_cell(folder), setting, seed)
    calibration = folder / "calibration"
    write_board(calibration / "board.yaml", BOARD)
    stereo = made.chain.stereo()
    save_stereo(calibration, stereo, BOARD, "", ORIGIN)
    save_handeye(calibration, "ECM", made.chain.handeye(stereo), ORIGIN)
    return made


@pytest.mark.full
def test_a_base_by_the_tip_in_the_simulators_pictures(tmp_path: Path) -> None:
    found, seeds, seed = [], 20, -1
    while len(found) < seeds:
        seed += 1
        root = tmp_path / str(seed)
        root.mkdir()
        try:
            scene = scene_of(seed, copied_cell(root))
        except ValueError as error:  # with some errors the scope does not see the instrument
            assert "does not see" in str(error)
            continue
        scene.write_rests(root / "tip", 12, np.random.default_rng(100 + seed))
        scene.renderer.close()  # one at a time can draw
        cell = surg_core.load_cell(scene.cell.folder)
        X_WB, fit, _ = base_steps.bases(cell, root / "tip", "tip", ORIGIN)
        off = rotation_vector(X_WB[:3, :3].T @ scene.chain.X_W_ECM[:3, :3])
        found.append([np.degrees(np.linalg.norm(off)), np.degrees(fit.error[0]), fit.n])
        print(
            f"seed {seed}: turn {found[-1][0]:.2f} deg off, stated {found[-1][1]:.2f}, n {fit.n}",
            flush=True,
        )
    off, stated, n = np.array(found).T
    inside = int((off <= 2.5 * stated).sum())
    PAGE.note(
        "base by tip, found in 12 rendered pairs with noise",
        seeds,
        f"turn: median {np.median(off):.2f}°, largest {off.max():.2f}°, stated "
        f"{np.median(stated):.2f}° (median); inside 2.5 sigma in {inside}; found in {n.min():.0f} "
        f"to {n.max():.0f}",
    )
    assert off.max() <= 2.0
    assert inside >= 0.95 * seeds
