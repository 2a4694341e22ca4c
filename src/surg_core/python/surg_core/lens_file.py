"""``calibration/endoscope_{left,right}.yaml``: a lens, in ROS's camera_info YAML.

The format is that of ``camera_calibration_parsers``, which ``camera_info_manager`` and
``image_proc`` read: http://wiki.ros.org/camera_calibration_parsers. Meaning of the matrices:
``sensor_msgs/CameraInfo``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from surg_core._core import ConfigError, Document
from surg_core.checked_document import CheckedDocument
from surg_core.config import PathLike
from surg_core.reading.foreign_lens import lens_document
from surg_core.replace_file import exact_numbers, one_line, replace_file, yaml_text
from surg_core.transforms import FloatArray

DISTORTION_MODELS: Mapping[str, int] = MappingProxyType(
    {"plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4}
)
"""Number of coefficients of each model, in OpenCV's order."""
_NAMES = {
    **{name: name for name in DISTORTION_MODELS},
    **dict.fromkeys(("radtan", "radial-tangential", "brown_conrady"), "plumb_bob"),
    **dict.fromkeys(("equi", "fisheye", "kannala_brandt4"), "equidistant"),
}
"""Names of the models, also those of Kalibr and OpenCV."""
ROUNDED, EXACT = 1e-3, 1e-6
"""Largest entry of R R^T - 1: of a rotation written with few decimals, and of one used as it is."""
LARGEST_PICTURE = 16384
LARGEST_COEFFICIENT = 1e4


@dataclass(frozen=True, eq=False)
class Lens:
    """One eye's intrinsics, as ``sensor_msgs/CameraInfo`` has them.

    Pixels are counted from the centre of the upper left one.

    Attributes:
        width: Of the picture [px].
        height: Of the picture [px].
        camera_name: Such as ``endoscope_left``; letters, digits, underscores.
        K: (3, 3) camera matrix of the raw picture [px].
        distortion_model: A key of :data:`DISTORTION_MODELS`.
        D: (n,) its coefficients.
        R: (3, 3) rotation from the raw camera's axes to the rectified one's.
        P: (3, 4) projection of the rectified camera [px]; its fourth column is -f times the
            baseline [px m], 0 for the left eye.
    """

    width: int
    height: int
    camera_name: str
    K: FloatArray
    distortion_model: str
    D: FloatArray
    R: FloatArray
    P: FloatArray

    @property
    def baseline(self) -> float:
        """From the left eye to this one along the rows [m]; 0 for the left eye."""
        return float(-self.P[0, 3] / self.P[0, 0])

    @property
    def camera_info(self) -> dict[str, Any]:
        """The members of ``sensor_msgs/CameraInfo`` that state it; matrices row by row."""
        return {
            "width": self.width,
            "height": self.height,
            "distortion_model": self.distortion_model,
            "D": self.D.tolist(),
            "K": self.K.ravel().tolist(),
            "R": self.R.ravel().tolist(),
            "P": self.P.ravel().tolist(),
        }

    def resized(self, width: int, height: int) -> Lens:
        """The same lens for a picture of another size and the same aspect.

        Raises:
            ConfigError: The aspect differs by more than half a pixel.
        """
        if (width, height) == (self.width, self.height):
            return self
        if abs(width * self.height - height * self.width) > 0.5 * max(self.width, self.height):
            raise ConfigError(
                f"{self.camera_name}: the lens file is for {self.width} x {self.height}, the "
                f"picture has {width} x {height}; allowed: the same size, or the same aspect. "
                f"Set the size to {self.width} x {self.height}, or repeat ./surg calibrate CELL "
                "stereo"
            )
        change = resizing((self.width, self.height), (width, height))
        return replace(self, width=width, height=height, K=change @ self.K, P=change @ self.P)


def resizing(size: tuple[int, int], to: tuple[int, int]) -> FloatArray:
    """(3, 3) matrix from a picture's pixels to those of the same picture in another size.

    Both sizes are width and height [px]. Centres of pixels are whole numbers, edges lie at halves.
    """
    x, y = to[0] / size[0], to[1] / size[1]
    return np.array([[x, 0.0, (x - 1) / 2], [0.0, y, (y - 1) / 2], [0.0, 0.0, 1.0]])


def parse_lens(document: Document) -> Lens:
    """The content of a lens file, checked.

    Raises:
        ConfigError: A key is missing, unknown or out of its range; names file, line, key, value
            and what is allowed.
    """
    doc = CheckedDocument(document)
    width = doc.count("image_width", 16, LARGEST_PICTURE)
    height = doc.count("image_height", 16, LARGEST_PICTURE)
    name = doc.text("camera_name", "letters, digits, - . / _", r"[A-Za-z0-9_./-]+")
    name = re.sub(r"[./-]", "_", name).strip("_") or "camera"
    model = _NAMES[doc.choice("distortion_model", tuple(_NAMES))]
    K = _matrix(doc, "camera_matrix", (3, 3), 1e6)
    model, D = _distortion(doc, model)
    R = _rotation(doc)
    P = _matrix(doc, "projection_matrix", (3, 4), 1e6)
    doc.finish()
    _check_intrinsics(doc, "camera_matrix.data", K, width, height)
    _check_intrinsics(doc, "projection_matrix.data", P[:, :3], 3 * width, 3 * height)
    if not (P[1:, 3] == 0.0).all():
        raise doc.refusal(
            "projection_matrix.data",
            f"has the fourth column {P[:, 3].tolist()}",
            "[-f * baseline, 0, 0]: the eyes lie side by side",
        )
    for array in (K, D, R, P):
        array.setflags(write=False)
    return Lens(width, height, name, K, model, D, R, P)


def load_lens(path: PathLike) -> Lens:
    """Read a lens file of ROS, OpenCV or Kalibr; errors as :func:`parse_lens`."""
    return parse_lens(lens_document(path))


def lens_text(lens: Lens, note: str = "") -> str:
    """The content of a lens file."""
    matrices = {
        "camera_matrix": lens.K,
        "distortion_coefficients": lens.D[None],
        "rectification_matrix": lens.R,
        "projection_matrix": lens.P,
    }
    head = (
        f"image_width: {lens.width}\n"
        f"image_height: {lens.height}\n"
        f"camera_name: {yaml_text(lens.camera_name)}\n"
        f"distortion_model: {yaml_text(lens.distortion_model)}\n"
    )
    body = "".join(
        f"{key}:\n  rows: {matrix.shape[0]}\n  cols: {matrix.shape[1]}\n"
        f"  data: {exact_numbers(matrix)}\n"
        for key, matrix in matrices.items()
    )
    return (f"# {one_line(note)}\n" if note else "") + head + body


def write_lens(path: PathLike, lens: Lens, note: str = "") -> None:
    """Write a lens file; the one that was there stays beside it as ``<name>.previous``.

    Args:
        path: Such as ``calibration/endoscope_left.yaml``; its folder must exist.
        lens: What to write.
        note: One line for people, put at the top.

    Raises:
        ConfigError: The reader would refuse it; nothing is replaced then.
        OSError: It cannot be written.
    """
    replace_file(Path(path), lens_text(lens, note), load_lens)


def check_eyes(left: Lens, right: Lens, left_file: str, right_file: str) -> None:
    """Refuse two lens files that do not make a stereo pair.

    Raises:
        ConfigError: They are of different sizes, or the eyes are swapped.
    """
    if (left.width, left.height) != (right.width, right.height):
        raise ConfigError(
            f"{right_file}: image_width, image_height: {right.width} x {right.height}; allowed: "
            f"{left.width} x {left.height} as in {left_file}. Repeat ./surg calibrate CELL stereo"
        )
    if left.P[0, 3] != 0.0 or not right.P[0, 3] < 0.0:
        swapped = left.P[0, 3] < 0.0 or right.P[0, 3] > 0.0
        why = "the eyes are swapped" if swapped else "no baseline"
        raise ConfigError(
            f"{right_file}: projection_matrix.data: fourth value {right.P[0, 3]:g}, and "
            f"{left.P[0, 3]:g} in {left_file}: {why}; allowed: negative here, 0 there. Exchange "
            "the cables (or set endoscope.swap in cell.yaml) and repeat ./surg calibrate CELL "
            "stereo"
        )


def _matrix(doc: CheckedDocument, key: str, shape: tuple[int, int], bound: float) -> FloatArray:
    for part, wanted in (("rows", shape[0]), ("cols", shape[1])):
        doc.count(f"{key}.{part}", wanted, wanted)
    return doc.numbers(f"{key}.data", shape[0] * shape[1], bound, "").reshape(shape)


def _rotation(doc: CheckedDocument) -> FloatArray:
    """A rotation; one that was written with few decimals is made orthonormal."""
    R = _matrix(doc, "rectification_matrix", (3, 3), 1.0 + ROUNDED)
    off = np.abs(R @ R.T - np.eye(3)).max()
    if not off <= ROUNDED or not np.linalg.det(R) > 0.0:
        raise doc.refusal(
            "rectification_matrix.data",
            "is no rotation",
            f"a 3 x 3 rotation matrix, R R^T within {ROUNDED:g} of 1",
        )
    if off > EXACT:
        u, _, v = np.linalg.svd(R)
        R = u @ v
    return R


def _distortion(doc: CheckedDocument, model: str) -> tuple[str, FloatArray]:
    """Model and coefficients; those of OpenCV's longer forms where they are 0 beyond ours."""
    key = "distortion_coefficients"
    n = doc.count(f"{key}.rows", 1, 14) * doc.count(f"{key}.cols", 1, 14)
    D = doc.numbers(f"{key}.data", n, LARGEST_COEFFICIENT, "")
    if n == DISTORTION_MODELS[model]:
        return model, D
    if model == "equidistant" or n not in (4, 5, 8, 12, 14):
        wanted = "4" if model == "equidistant" else "4, 5, 8, 12 or 14"
        raise doc.refusal(f"{key}.data", f"{n} numbers for {model}", f"{wanted} numbers")
    if D[8:].any():
        raise doc.refusal(
            f"{key}.data",
            f"terms 9 to {n} are {D[8:].tolist()}",
            "0 there: a thin prism and a tilted sensor are not corrected",
            "Calibrate without CALIB_THIN_PRISM_MODEL and CALIB_TILTED_MODEL",
        )
    full = np.concatenate([D[:8], np.zeros(8 - len(D[:8]))])
    return ("rational_polynomial", full) if full[5:].any() else ("plumb_bob", full[:5])


def _check_intrinsics(
    doc: CheckedDocument, key: str, K: FloatArray, width: int, height: int
) -> None:
    """Focal lengths positive, no skew, the principal point near the picture, last row 0 0 1."""
    if K[0, 1] != 0.0:
        raise doc.refusal(
            key,
            f"has a skew of {K[0, 1]:g} px",
            "0: pixels are rectangles, also for OpenCV, which would ignore it",
            "Calibrate again without skew",
        )
    good = K[0, 0] > 1.0 and K[1, 1] > 1.0 and K[0, 1] == K[1, 0] == 0.0
    good = good and K[2].tolist() == [0.0, 0.0, 1.0]
    good = good and abs(K[0, 2] - width / 2) <= width and abs(K[1, 2] - height / 2) <= height
    if not good:
        raise doc.refusal(
            key,
            f"{K.round(6).tolist()} is no camera matrix",
            "[fx, 0, cx, 0, fy, cy, 0, 0, 1] in px, (cx, cy) near the picture",
            "Repeat ./surg calibrate CELL stereo",
        )
