"""Show: a cell with unknown errors of base, camera and lens, before and after its calibration.

The pictures are the simulator's, through its lens. The tip goes where the cell believes that right,
down and away are in the picture; check-frames' own tracker and judge state what they see.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import surg_core
from helpers.endoscope_files import copied_cell
from helpers.results.perception_results import PAGE
from helpers.sim.board_views import BARREL, Array
from helpers.sim.unknown_scene import UnknownScene
from surg_core.held_endoscope import HeldEndoscope, held_endoscope
from surg_core.lens_file import load_lens
from surg_perception.calibration.small_motions import rotation_vector
from surg_sim.physics.patient_settings import PatientSetting
from surg_sim.physics.pose_error import PoseError
from surg_teleop.frames.probe_moves import STEPS
from surg_teleop.frames.registration_verdict import (
    CALIBRATED_ANGLE,
    Lens,
    RegistrationOutcome,
    Verdict,
    judge,
)
from surg_teleop.frames.tip_tracker import find_places
from surg_teleop.frames.undistortion import EyeModel, straighten

UNKNOWN = PatientSetting(
    "unknown",
    base_error=PoseError(0.008, np.radians(3.0), seed=1),
    camera_error=PoseError(0.005, np.radians(15.0), seed=5),
    lens=BARREL,
)


class Scene(UnknownScene):
    """With check-frames looking at it."""

    def off(self, camera: HeldEndoscope) -> float:
        """True angle between where the picture looks and where it is believed to look [deg]."""
        R_believed = camera.rotation(self.home)
        arm = self.cell.arms["ECM"]
        X_true = self.chain.X_W_ECM @ arm.chain.forward(self.home) @ self.chain.bench.X_FV
        return float(np.degrees(np.linalg.norm(rotation_vector(R_believed.T @ X_true[:3, :3]))))

    def verdict(self, camera: HeldEndoscope, turn: Array) -> Verdict:
        """What check-frames states at 8 degrees, with the camera turned by (3, 3) besides."""
        R_WV = camera.rotation(self.home) @ turn
        seen = {step: self.pictures(R_WV @ step.offset()) for step in STEPS}
        places = find_places(*({k: v[eye] for k, v in seen.items()} for eye in ("left", "right")))
        eyes, lens = self.lenses(self.cell.folder / "calibration")
        return judge(straighten(places, *eyes), lens, CALIBRATED_ANGLE)

    def lenses(self, folder: Path) -> tuple[tuple[EyeModel, EyeModel], Lens]:
        """Both eyes as believed: the files, else the pinhole of the instrument."""
        if not (folder / "endoscope_left.yaml").is_file():
            K = self.renderer.intrinsics.K
            eye = EyeModel(K, np.zeros(5), "plumb_bob", np.eye(3))
            return (eye, eye), Lens(K[0, 0], K[:2, 2], self.renderer.baseline)
        found = [load_lens(folder / f"endoscope_{eye}.yaml") for eye in ("left", "right")]
        left, right = (EyeModel(f.K, f.D, f.distortion_model, f.R) for f in found)
        return (left, right), Lens(left.K[0, 0], left.K[:2, 2], found[1].baseline)


@pytest.mark.full
def test_the_chain_brings_hand_and_picture_together(tmp_path: Path) -> None:
    folder = copied_cell(tmp_path)
    scene = Scene(surg_core.load_cell(folder), UNKNOWN)
    stated = held_endoscope(scene.cell)
    assert stated is not None
    unknown = scene.verdict(stated, np.eye(3))
    scene.chain.write(folder / "calibration")
    lens_only = scene.verdict(stated, np.eye(3))
    measured = held_endoscope(surg_core.load_cell(folder))
    assert measured is not None
    after = scene.verdict(measured, np.eye(3))
    turn = surg_core.axis_angle_to_matrix(np.array([0.3, 0.4, 1.0]), np.radians(12.0))
    wrong = scene.verdict(measured, turn)
    PAGE.note(
        "check-frames, base 3°, camera 15° and lens unknown",
        1,
        f"true {scene.off(stated):.1f}°, stated {_said(unknown)}, with the lens measured "
        f"{_said(lens_only)}; after the chain true {scene.off(measured):.2f}°, stated "
        f"{_said(after)}; camera then 12° off: {_said(wrong)}",
    )
    assert lens_only.outcome is RegistrationOutcome.FAIL
    assert after.outcome is RegistrationOutcome.PASS and scene.off(measured) < 0.3
    assert wrong.outcome is RegistrationOutcome.FAIL


def _said(verdict: Verdict) -> str:
    return f"{np.degrees(verdict.angle):.1f}° ({verdict.outcome.value})"
