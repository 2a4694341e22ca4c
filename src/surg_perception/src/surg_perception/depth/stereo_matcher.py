"""Methods that find the disparity of a rectified pair: the interface, and how one is chosen.

``sgbm`` and ``sgbm_8`` are bundled. A ``.py`` file, or an entry point in the group
``surg_perception.matchers``, adds a method of one's own, such as a learned model. It is executed:
name none that you would not run.
"""

from __future__ import annotations

import abc
import math

import numpy as np
import numpy.typing as npt

from surg_core.plugins import PluginError, PluginKind
from surg_perception.depth.rectification import PairGeometry, Picture

Disparity = npt.NDArray[np.float32]

NEAR, FAR = 0.04, 0.30
"""[m] Range of distances that is looked for."""


class MatcherError(ValueError):
    """A method that cannot be used; says why, what is allowed, what to do."""


class StereoMatcher(abc.ABC):
    """Finds disparities.

    Args:
        geometry: Of the rectified pairs.
        near: Smallest distance that is looked for [m].
        far: Largest distance that is looked for [m].
    """

    def __init__(self, geometry: PairGeometry, near: float = NEAR, far: float = FAR) -> None:
        self.geometry = geometry
        self.least = geometry.disparity(far)
        """Smallest disparity that is looked for [px]."""
        self.most = geometry.disparity(near)
        """Largest one [px]."""

    @abc.abstractmethod
    def disparity(self, left: Picture, right: Picture) -> Disparity:
        """Disparity (h, w) of each pixel of the left picture [px]; NaN: not found.

        Args:
            left: (h, w, 3) rgb8, rectified.
            right: The same.
        """


MATCHERS = PluginKind(
    "stereo method",
    "surg_perception.matchers",
    {
        "sgbm": "surg_perception.depth.methods.sgbm",
        "sgbm_8": "surg_perception.depth.methods.sgbm_eight",
    },
    lambda kind: issubclass(kind, StereoMatcher) and kind is not StereoMatcher,
    "one class derived from surg_perception.depth.stereo_matcher.StereoMatcher",
)


def find_matcher(
    method: str, geometry: PairGeometry, near: float = NEAR, far: float = FAR
) -> StereoMatcher:
    """The method of this name, for pairs of this geometry.

    Raises:
        MatcherError: There is none, it cannot be loaded, or the range of distances is not one.
    """
    if not (math.isfinite(near) and math.isfinite(far) and 0.005 <= near < far <= 10.0):
        raise MatcherError(
            f"near {near:g} m, far {far:g} m: allowed: 0.005 <= near < far <= 10; the defaults are "
            f"{NEAR:g} and {FAR:g}"
        )
    try:
        found: StereoMatcher = MATCHERS.find(method)(geometry, near, far)
    except PluginError as error:
        raise MatcherError(f"method {error}") from error
    return found
