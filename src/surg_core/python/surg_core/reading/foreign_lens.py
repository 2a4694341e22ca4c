"""Lens files in the forms of OpenCV's ``FileStorage`` and of Kalibr, as documents like ROS's own.

Neither states rectification: the picture is taken as rectified by its own camera matrix.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from surg_core._core import ConfigError, Document, read_document
from surg_core.config import PathLike

_OPENCV, _KALIBR = re.compile(r"%YAML:|!!opencv-matrix"), re.compile(r"^cam\d+:", re.MULTILINE)
_NO_TURN = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]


def lens_document(path: PathLike) -> Document:
    """The document of a lens file in any of the forms.

    Raises:
        ConfigError: It cannot be read, is XML, or describes several cameras.
    """
    try:
        text = Path(path).read_text("utf-8-sig")
    except (OSError, UnicodeDecodeError):
        return read_document(path)  # says why not
    if text.lstrip().startswith("<"):
        raise ConfigError(f"{path}: is XML; allowed: YAML, as OpenCV writes to a name with .yml")
    if _OPENCV.search(text):
        return Document(str(path), _of_opencv(path, _parsed(path, text)))
    if _KALIBR.search(text):
        return Document(str(path), _of_kalibr(path, _parsed(path, text)))
    return read_document(path)


def _parsed(path: PathLike, text: str) -> Mapping[str, Any]:
    import yaml  # only for the forms of others

    plain = re.sub(r"^%YAML:.*$|!!opencv-\S+", "", text, flags=re.MULTILINE)
    try:
        found = yaml.safe_load(plain)
    except (yaml.YAMLError, RecursionError) as problem:
        reason = " ".join(str(problem).split())
        raise ConfigError(f"{path}: is not YAML: {reason}") from None
    return found if isinstance(found, Mapping) else {}


def _of_opencv(path: PathLike, stated: Mapping[str, Any]) -> dict[str, Any]:
    """OpenCV's calibration program writes ``camera_matrix`` or ``Camera_Matrix``, and so on."""
    found = {key.lower(): value for key, value in stated.items()}
    D = _matrix(path, found, "distortion_coefficients")
    fisheye = bool(found.get("fisheye_model"))
    return _document(
        re.sub(r"[^A-Za-z0-9_]", "_", Path(path).stem),
        (found.get("image_width"), found.get("image_height")),
        _matrix(path, found, "camera_matrix"),
        "equidistant" if fisheye else "plumb_bob",
        D,
    )


def _matrix(path: PathLike, stated: Mapping[str, Any], key: str) -> list[Any]:
    matrix = stated.get(key)
    if not isinstance(matrix, Mapping) or not isinstance(matrix.get("data"), list):
        raise ConfigError(f"{path}: {key} is missing; allowed: a matrix as OpenCV writes it")
    return list(matrix["data"])


def _of_kalibr(path: PathLike, stated: Mapping[str, Any]) -> dict[str, Any]:
    cameras = {key: value for key, value in stated.items() if re.fullmatch(r"cam\d+", str(key))}
    if len(cameras) != 1:
        raise ConfigError(
            f"{path}: describes {len(cameras)} cameras ({', '.join(cameras)}); a lens file is of"
            " one eye. Delete the others, or calibrate both by ./surg calibrate CELL stereo"
        )
    ((name, camera),) = cameras.items()
    try:
        kind, (fx, fy, cx, cy) = camera["camera_model"], camera["intrinsics"]
        width, height = camera["resolution"]
        model, D = camera["distortion_model"], list(camera["distortion_coeffs"])
    except (KeyError, TypeError, ValueError) as problem:
        raise ConfigError(
            f"{path}: {name}: {problem!r}; allowed: camera_model, intrinsics of four numbers,"
            " resolution, distortion_model and distortion_coeffs, as Kalibr writes them"
        ) from None
    if kind != "pinhole":
        raise ConfigError(
            f"{path}: {name}.camera_model: {kind!r}; allowed: pinhole. Repeat Kalibr with"
            " --models pinhole-radtan or pinhole-equi"
        )
    K = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
    return _document(str(name), (width, height), K, str(model), D)


def _document(
    name: str, size: tuple[Any, Any], K: list[Any], model: str, D: list[Any]
) -> dict[str, Any]:
    """The keys of ROS's form."""
    rows = [[*K[3 * i : 3 * i + 3], 0.0] for i in range(len(K) // 3)]
    P = [value for row in rows for value in row]
    found: dict[str, Any] = {"camera_name": name, "distortion_model": model}
    for key, value in zip(("image_width", "image_height"), size, strict=True):
        if value is not None:
            found[key] = float(value)
    for key, (height, width), values in (
        ("camera_matrix", (3, 3), K),
        ("distortion_coefficients", (1, len(D)), D),
        ("rectification_matrix", (3, 3), _NO_TURN),
        ("projection_matrix", (3, 4), P),
    ):
        found |= {f"{key}.rows": float(height), f"{key}.cols": float(width)}
        found[f"{key}.data"] = [float(value) for value in values]
    return found
