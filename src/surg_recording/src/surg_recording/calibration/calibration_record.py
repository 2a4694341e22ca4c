"""Through which lens and from where a recording looks: calibration in a data set.

``meta/calibration/`` holds each set of files once, as they were in the cell, and ``index.json``:
``episodes`` (number of the set of each episode) and ``sets`` (SHA-256 of each file, the camera
models of ``camera_info`` in the size of the data set's pictures, the chain from joints to camera).
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from surg_core import ConfigError
from surg_core.held_endoscope import HeldEndoscope, from_description, pose_numbers
from surg_core.lens_file import resizing
from surg_core.transforms import continuous_quaternions
from surg_recording.recording_errors import EpisodeError

FOLDER = "calibration"
INDEX = "index.json"
_NAME = re.compile(r"[A-Za-z0-9_]+\.yaml")

Array = npt.NDArray[np.float64]


def of_manifest(
    place: object, manifest: Mapping[str, Any], size: tuple[int, int] | None = None
) -> dict[str, Any]:
    """``files`` {name: text}, ``camera_info`` and ``endoscope`` of a manifest.

    The camera models are those of pictures of ``size`` (width, height); None: as recorded.

    Raises:
        EpisodeError: A file's text does not have the hash that the manifest states, or a camera
            model cannot be resized.
    """
    cell = manifest.get("cell") or {}
    hashes = cell.get("files") or {}
    files = {}
    for path, text in (cell.get("calibration") or {}).items():
        name = Path(path).name
        stated = hashes.get(path)
        found = hashlib.sha256(text.encode()).hexdigest()
        if not _NAME.fullmatch(name) or stated != found:
            raise EpisodeError(
                f"{place}: key 'cell.calibration.{path}' has the hash {found[:12]}…; allowed: that"
                f" of 'cell.files', {str(stated)[:12]}…: the manifest was edited"
            )
        files[name] = text
    models = {
        camera: _model(place, camera, model, size)
        for camera, model in (manifest.get("camera_info") or {}).items()
    }
    return {"files": files, "camera_info": models, "endoscope": cell.get("endoscope")}


def _model(place: object, camera: str, model: Any, size: tuple[int, int] | None) -> dict[str, Any]:
    """A camera model, checked, for pictures of ``size``; lens and distortion stay."""
    try:
        recorded = (model["width"], model["height"])
        change = resizing(recorded, size or recorded)
        K, P = (np.reshape(model[key], (3, -1)).astype(float) for key in ("K", "P"))
        if K.shape != (3, 3) or P.shape != (3, 4) or not np.isfinite([K.sum(), P.sum()]).all():
            raise ValueError(f"K has the shape {K.shape}, P {P.shape}, or one is not finite")
    except (KeyError, TypeError, ValueError, ZeroDivisionError) as problem:
        raise EpisodeError(
            f"{place}: key 'camera_info.{camera}' is no camera model ({problem!r}); allowed: width,"
            " height, K (9 numbers) and P (12 numbers)"
        ) from None
    if size is None:
        return dict(model)
    matrices = {key: (change @ old).ravel().tolist() for key, old in (("K", K), ("P", P))}
    return {**model, **matrices, "width": size[0], "height": size[1]}


def endoscope_of(place: object, manifest: Mapping[str, Any]) -> HeldEndoscope | None:
    """The endoscope whose pose is known from its arm's joints; None: there is none.

    Raises:
        EpisodeError: The manifest's description of it is broken.
    """
    described = (manifest.get("cell") or {}).get("endoscope")
    if described is None:
        return None
    try:
        held = from_description(described)
    except ConfigError as problem:
        raise EpisodeError(f"{place}: key 'cell.endoscope': {problem}") from problem
    return None if held.X_FV is None else held


def camera_poses(held: HeldEndoscope, q: Array) -> Array:
    """X_WV at joint positions (N, n) [rad] as (N, 7): position [m], quaternion x, y, z, w."""
    numbers = pose_numbers(held.poses(q))
    numbers[:, 3:] = continuous_quaternions(numbers[:, 3:])
    return numbers


def write(about: Sequence[Mapping[str, Any]], folder: Path) -> None:
    """Write the calibrations of episodes, in their order, into ``folder/calibration``.

    Nothing is written if no episode has any. ``about`` holds the parts' facts.
    """
    places, sets = grouped(about)
    if not any(each.get("files") or each.get("camera_info") for each in sets):
        return
    for number, each in enumerate(sets):
        of_set = folder / FOLDER / str(number)
        of_set.mkdir(parents=True)
        for name, text in each.get("files", {}).items():
            (of_set / name).write_bytes(text.encode())
    index = {
        "episodes": places,
        "sets": [{**each, "files": hashes(each)} for each in sets],
    }
    (folder / FOLDER / INDEX).write_text(json.dumps(index, indent=1) + "\n", "utf-8")


def grouped(about: Sequence[Mapping[str, Any]]) -> tuple[list[int], list[dict[str, Any]]]:
    """The number of each episode's calibration, and the different calibrations in this order."""
    found = [dict(each.get("calibration") or {}) for each in about]
    sets = {text_of(each): each for each in found}
    numbers = {text: number for number, text in enumerate(sets)}
    return [numbers[text_of(each)] for each in found], list(sets.values())


def check(folder: Path, episodes: int) -> list[str]:
    """Errors of a written ``calibration`` folder; none where there is no such folder."""
    path = folder / FOLDER / INDEX
    if not path.exists():
        return []
    index = json.loads(path.read_text("utf-8"))
    errors = []
    if len(index["episodes"]) != episodes:
        errors.append(f"{path}: {len(index['episodes'])} episodes, the data set has {episodes}")
    for number, each in enumerate(index["sets"]):
        for name, stated in each["files"].items():
            file = folder / FOLDER / str(number) / name
            if not file.is_file() or hashlib.sha256(file.read_bytes()).hexdigest() != stated:
                errors.append(f"{file}: is not the file that was recorded")
    return errors


def hashes(calibration: Mapping[str, Any]) -> dict[str, str]:
    """SHA-256 of each file of a calibration, by name."""
    files = calibration.get("files") or {}
    return {name: hashlib.sha256(text.encode()).hexdigest() for name, text in files.items()}


def text_of(calibration: Mapping[str, Any]) -> str:
    """A calibration as one line of JSON, for attributes of formats without files of their own."""
    return json.dumps(calibration, sort_keys=True)
