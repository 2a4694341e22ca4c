"""What people may watch of a running policy: its plan, and what it says that it sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surg_policy_client.attention import Attention

LONGEST = 32
"""Steps of a plan; a policy's observation is too old for later ones anyway."""
MOST_VALUES = 256
"""Numbers of a plan; a recording keeps no more of an array."""


def shown_rows(width: int) -> int:
    """How many steps of a plan are shown, if each has so many numbers."""
    return min(LONGEST, MOST_VALUES // max(width, 1))


@dataclass(frozen=True)
class PolicyPlan:
    """One answer to an observation.

    Attributes:
        session: Of the policy.
        seq: Of the observation.
        stamp_ns: Of the observation [ns].
        first: Grid time of the first row.
        rows: (K, A) absolute targets that are queued now, in the rcm frames of the arms.
        seen: What the policy saw in the observation; None: it says nothing valid.
        unseen: Why what it says was dropped; empty: it was not.
    """

    session: int
    seq: int
    stamp_ns: int
    first: int
    rows: NDArray[np.float64]
    seen: Attention | None = None
    unseen: str = ""
