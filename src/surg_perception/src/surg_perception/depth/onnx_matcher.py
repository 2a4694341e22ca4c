"""A learned stereo model in an ONNX file. None is shipped: bring one whose licence you know.

The model takes two pictures (1, 3, h, w), float32, rgb from 0 to 1, left first, and returns the
left picture's disparity [px] with h x w values. A model of fixed size gets the pictures resized.
onnxruntime (MIT) is optional and not a dependency.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from surg_perception.depth.rectification import PairGeometry, Picture
from surg_perception.depth.stereo_matcher import (
    FAR,
    NEAR,
    Disparity,
    MatcherError,
    StereoMatcher,
)


class OnnxMatcher(StereoMatcher):
    """Runs a model on the processor.

    Args:
        path: The ``.onnx`` file.
        geometry: As for :class:`StereoMatcher`, and near and far too.
        near: As there.
        far: As there.
        session: An ``onnxruntime.InferenceSession``; None: one of the file.

    Raises:
        MatcherError: No file, no onnxruntime, or a model of another shape.
    """

    def __init__(
        self,
        path: str,
        geometry: PairGeometry,
        near: float = NEAR,
        far: float = FAR,
        session: Any = None,
    ) -> None:
        super().__init__(geometry, near, far)
        self._path = path
        self._session = _open(path) if session is None else session
        inputs = self._session.get_inputs()
        if len(inputs) != 2 or any(len(each.shape) != 4 for each in inputs):
            shapes = ", ".join(f"{each.name} {each.shape}" for each in inputs)
            raise MatcherError(
                f"method {path}: its inputs are {shapes}; allowed: two pictures (1, 3, h, w), "
                "the left one first"
            )
        self._names = [each.name for each in inputs]
        height, width = inputs[0].shape[2:]
        fixed = isinstance(height, int) and isinstance(width, int)
        self._size = (width, height) if fixed else geometry.size

    def disparity(self, left: Picture, right: Picture) -> Disparity:
        """As the interface says.

        Raises:
            MatcherError: The model fails, or returns another shape.
        """
        feed = {name: self._tensor(p) for name, p in zip(self._names, (left, right), strict=True)}
        try:
            values = np.asarray(self._session.run(None, feed)[0], np.float32)
        except Exception as error:  # the runtime's own kinds of errors are no part of its interface
            raise MatcherError(f"method {self._path}: the model failed: {error}") from error
        width, height = self._size
        if values.size != width * height:
            raise MatcherError(
                f"method {self._path}: its output has the shape {list(values.shape)}; allowed: "
                f"{height} x {width} disparities [px] of the left picture"
            )
        found = cv2.resize(values.reshape(height, width), left.shape[1::-1])
        found = found * np.float32(left.shape[1] / width)
        known = np.isfinite(found) & (found >= self.least) & (found <= self.most)
        return np.where(known, found, np.float32(np.nan))

    def _tensor(self, picture: Picture) -> np.ndarray:
        sized = cv2.resize(picture, self._size, interpolation=cv2.INTER_AREA)
        return np.ascontiguousarray(sized.transpose(2, 0, 1)[None], dtype=np.float32) / 255.0


def _open(path: str) -> Any:
    if not Path(path).is_file():
        raise MatcherError(f"method {path}: there is no such file; allowed: the path of a model")
    try:
        import onnxruntime
    except ImportError as error:
        raise MatcherError(
            f"method {path}: onnxruntime is not installed; run .venv/bin/pip install onnxruntime, "
            "or use sgbm"
        ) from error
    try:
        return onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    except Exception as error:
        raise MatcherError(f"method {path}: is no model that onnxruntime reads: {error}") from error
