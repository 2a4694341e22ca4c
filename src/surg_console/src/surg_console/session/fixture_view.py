"""Virtual fixtures of the driven arm for the page: in the trocar frame, with distances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from surg_core import Fixture
from surg_core.transforms import FloatArray


@dataclass(frozen=True)
class FixtureView:
    """Regions and tip of one arm.

    Attributes:
        regions: the arm's fixtures, in the robot base frame.
        p_BTip: ``(3,)`` measured tip [m].
        X_BR: ``(4, 4)`` the rcm frame in the base frame.
    """

    regions: Sequence[Fixture]
    p_BTip: FloatArray
    X_BR: FloatArray

    def as_json(self) -> dict[str, Any]:
        """Positions in the rcm frame [m]; a distance is negative beyond the wall."""
        R_RB, p_BRcm = self.X_BR[:3, :3].T, self.X_BR[:3, 3]
        return {
            "tip": (R_RB @ (self.p_BTip - p_BRcm)).tolist(),
            "regions": [
                {
                    "name": region.name,
                    "shape": region.shape,
                    "side": region.side,
                    "of": region.of,
                    "point": (R_RB @ (region.point - p_BRcm)).tolist(),
                    "axis": (R_RB @ region.axis).tolist(),
                    "radius": region.radius,
                    "distance": region.distance(self.p_BTip, p_BRcm),
                }
                for region in self.regions
            ],
        }


def region_of(name: str, shape: str, side: str, of: str, **places: Any) -> Fixture:
    """A fixture of a message's fields: ``point``, ``normal``, ``end`` ``(3,)`` and ``radius``.

    Raises:
        ValueError: for a region that the controller would refuse too.
    """
    point = np.asarray(places["point"])
    axis = places["normal"] if shape == "plane" else np.asarray(places["end"]) - point
    return Fixture(name, shape, side, of, point, axis, places["radius"])
