"""Marks in the raw pictures of both eyes, with the two-sigma ellipse of the calibration chain."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from surg_core import ConfigError, inverse_pose
from surg_core.base_file import load_base
from surg_core.camera_file import load_camera
from surg_core.config import Cell
from surg_core.held_endoscope import STEREO, HeldEndoscope, held_endoscope
from surg_core.lens_file import Lens
from surg_core.pictures.eye_projection import EyeProjection
from surg_core.stereo_file import load_stereo
from surg_core.transforms import FloatArray, skew
from surg_perception.marks.instrument_marks import InstrumentMarks, Mark


@dataclass(frozen=True)
class PictureMark:
    """One mark in one eye's raw picture.

    Attributes:
        arm: Name of the arm.
        name: ``tip``, ``shaft``, ``jaw`` or ``trocar``.
        pixels: (n, 2); NaN: not before the eye.
        covariance: (2, 2) of the first point [px^2]; None: nobody has measured the whole chain.
    """

    arm: str
    name: str
    pixels: FloatArray
    covariance: FloatArray | None = None

    def ellipse(self) -> tuple[float, float, float] | None:
        """Half axes [px], and the angle of the longer one from x [rad], at two sigma."""
        if self.covariance is None or not np.isfinite(self.covariance).all():
            return None
        values, axes = np.linalg.eigh(self.covariance)
        long = axes[:, 1]
        two_sigma = 2.0 * np.sqrt(np.maximum(values, 0.0))
        return float(two_sigma[1]), float(two_sigma[0]), float(np.arctan2(long[1], long[0]))


class MarkProjection:
    """Marks of all instruments of a cell in the pictures of its endoscope.

    Args:
        cell: As everybody but the simulator believes it.
        lenses: Of the left eye, or of both, for the pictures' size.

    Raises:
        ConfigError: No arm holds the endoscope, only its rotation is known, or a file is stale.
    """

    def __init__(self, cell: Cell, lenses: tuple[Lens, ...]) -> None:
        held = held_endoscope(cell)
        if held is None:
            raise ConfigError(
                f"{cell.config.file}: no arm holds the endoscope, so nothing is known of where it "
                "looks; allowed: a cell with an arm that holds one, such as sim_two_arms"
            )
        held.poses(np.zeros((1, len(held.chain.joints))))  # refuses a rotation without a place
        self.held: HeldEndoscope = held
        self.eyes = [EyeProjection(lenses[0], np.eye(4))]
        if len(lenses) == 2:
            if held.X_LR is None:
                raise ConfigError(f"{cell.config.file}: the instrument has one camera, not two")
            self.eyes.append(EyeProjection(lenses[1], held.X_LR))
        self._instruments = {
            name: InstrumentMarks(arm) for name, arm in cell.arms.items() if name != held.arm
        }
        self._known = {name: _Covariance.of(cell, held, name) for name in self._instruments}

    @property
    def arms(self) -> tuple[str, ...]:
        """Names of the arms whose instruments are marked."""
        return tuple(self._instruments)

    def marks(
        self, arm: str, q: FloatArray, jaw: float, q_scope: FloatArray
    ) -> list[list[PictureMark]]:
        """Marks of an arm in each eye.

        Args:
            arm: Name of the arm.
            q: (n,) its joints [rad].
            jaw: Angle of its fingers [rad]; NaN: unknown.
            q_scope: (n,) joints of the arm that holds the endoscope [rad].
        """
        X_WV = self.held.poses(q_scope[None])[0]
        X_VW = inverse_pose(X_WV)
        found: list[list[PictureMark]] = [[] for _ in self.eyes]
        for mark in self._instruments[arm].at(q, jaw):
            p_V = mark.p_W @ X_VW[:3, :3].T + X_VW[:3, 3]
            for eye, marks in zip(self.eyes, found, strict=True):
                marks.append(self._drawn(mark, p_V, X_VW, eye))
        return found

    def _drawn(
        self, mark: Mark, p_V: FloatArray, X_VW: FloatArray, eye: EyeProjection
    ) -> PictureMark:
        pixels, known = eye.pixels(p_V), self._known[mark.arm]
        covariance = None
        if mark.name == "tip" and known is not None and np.isfinite(pixels).all():
            J = eye.derivative(p_V[0])
            in_space = known.at(mark.p_W[0], p_V[0], X_VW)
            covariance = J @ in_space @ J.T + known.pixel**2 * np.eye(2)
        return PictureMark(mark.arm, mark.name, pixels, covariance)


@dataclass(frozen=True)
class _Covariance:
    """What the calibrated files state of their own errors.

    Attributes:
        tool: Of the tip, one sigma of its length [m].
        bases: Of each measured base: (6, 6), and its origin (3,) in the world [m].
        handeye: (6, 6) of the left eye in the flange.
        R_VF: (3, 3) from the flange to the left eye.
        pixel: Of the lens, one sigma [px].
    """

    tool: float
    bases: tuple[tuple[FloatArray, FloatArray], ...]
    handeye: FloatArray
    R_VF: FloatArray
    pixel: float

    @classmethod
    def of(cls, cell: Cell, held: HeldEndoscope, arm: str) -> _Covariance | None:
        """For the instrument of an arm; None: a part of the chain is not measured."""
        folder: Path = cell.folder / "calibration"
        first = next(iter(cell.arms))
        bases = [folder / f"base_{name}.yaml" for name in (held.arm, arm) if name != first]
        camera_file, stereo_file = folder / f"camera_{held.arm}.yaml", folder / f"{STEREO}.yaml"
        if not all(file.is_file() for file in (*bases, camera_file, stereo_file)):
            return None
        camera = load_camera(camera_file)
        of_camera = camera.through_lenses
        if of_camera is None:
            return None
        measured = [load_base(file) for file in bases]
        return cls(
            tool=float(cell.arms[arm].tool.residual),
            bases=tuple((base.evidence.covariance, base.X_WB[:3, 3]) for base in measured),
            handeye=of_camera,
            R_VF=camera.R_FV.T,
            pixel=float(load_stereo(stereo_file).held_out_px),
        )

    def at(self, p_W: FloatArray, p_V: FloatArray, X_VW: FloatArray) -> FloatArray:
        """Covariance (3, 3) of a tip in the left eye's axes [m^2]; the parts add up."""
        total = self.tool**2 / 3.0 * np.eye(3)
        for covariance, origin in self.bases:
            total = total + _carried(covariance, p_W - origin, X_VW[:3, :3])
        return total + _carried(self.handeye, self.R_VF.T @ p_V, self.R_VF)


def _carried(covariance: FloatArray, lever: FloatArray, R: FloatArray) -> FloatArray:
    """Covariance (3, 3) of a point that a pose carries, in axes turned by R (3, 3)."""
    J = R @ np.hstack([-skew(lever), np.eye(3)])
    return np.asarray(J @ covariance @ J.T)
