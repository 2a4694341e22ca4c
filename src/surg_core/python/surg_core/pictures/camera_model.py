"""A lens from a camera's model as manifests and ``sensor_msgs/CameraInfo`` state it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from surg_core._core import ConfigError, Document
from surg_core.lens_file import Lens, parse_lens


def lens_of(where: str, name: str, model: Mapping[str, Any] | None) -> Lens:
    """The lens of a camera model, checked as a lens file is.

    Args:
        where: Where it stands, for messages.
        name: Of the camera.
        model: ``width``, ``height``, ``distortion_model``, ``D``, ``K``, ``R``, ``P``; None: there
            is none.

    Raises:
        ConfigError: Nobody has measured the lens, or a value is not allowed.
    """
    if not model or not np.any(model.get("K") or 0.0):
        why = "is missing" if not model else "has no focal length"
        raise ConfigError(
            f"{where} {why}: nothing says through which lens the pictures look; allowed: a "
            "measured lens. Run ./surg calibrate CELL stereo first"
        )
    shapes = {
        "camera_matrix": ("K", 3, 3),
        "distortion_coefficients": ("D", 1, len(model.get("D") or ())),
        "rectification_matrix": ("R", 3, 3),
        "projection_matrix": ("P", 3, 4),
    }
    values: dict[str, Any] = {
        "image_width": model.get("width"),
        "image_height": model.get("height"),
        "camera_name": name,
        "distortion_model": model.get("distortion_model"),
    }
    try:
        for key, (short, rows, columns) in shapes.items():
            numbers = [float(each) for each in model[short]]
            values.update({f"{key}.rows": rows, f"{key}.cols": columns, f"{key}.data": numbers})
        return parse_lens(Document(where, values))
    except ConfigError:
        raise
    except (KeyError, TypeError, ValueError) as problem:
        raise ConfigError(f"{where}: is no camera model ({problem!r})") from problem
