"""What the whole chain is worth: how well joints and picture agree at a place before the scope.

The tip is known by its joints through tool and base; the picture states the same place through
stereo and hand-eye. The covariances of the parts add up. Where two parts share an error, such as a
base that was measured through the hand-eye pose, the sum is on the safe side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

DISTANCE = 0.08
"""[m] Before the left eye, where the error is stated."""


@dataclass(frozen=True)
class ChainError:
    """Parts of the expected error at one place, one sigma of the length [m].

    Attributes:
        tool: Of the tip in the flange.
        base: Of the base that was measured.
        handeye: Of the eye in the flange.
        stereo: Of a triangulated point.
    """

    tool: float
    base: float
    handeye: float
    stereo: float

    @property
    def two_sigma(self) -> float:
        """Twice the root of the summed variances [m]."""
        parts = (self.tool, self.base, self.handeye, self.stereo)
        return 2.0 * float(np.linalg.norm(parts))
