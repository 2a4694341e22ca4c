"""What sightings together say of the parts of the chain."""

from __future__ import annotations

from dataclasses import dataclass

from surg_core.transforms import FloatArray
from surg_perception.drift.moving_parts import Part

NOTHING = "nothing"
STILL_LIKELY = 0.5
"""Probability of no motion above which the chain counts as one at rest."""
MISFIT = 2.0
"""[sigma^2] Largest median residual of what a hypothesis explains. A true one leaves 0.2 to 0.8,
another motion than the joints' mostly more."""


@dataclass(frozen=True)
class Verdict:
    """Of all kept sightings.

    Attributes:
        probabilities: Of `NOTHING` and of each part's name; their sum is 1.
        best: The most probable part.
        x: (P,) steps of all parts, if the best one moved.
        beside: How far the newest instruments are seen beside their place [m]: least, expected,
            largest, 95 %.
        misfit: Median squared residual of sightings since, by the best hypothesis [sigma^2].
        since: Stamp of the first sighting after the best part moved [s].
        sightings: How many there are since.
        confirmed: Whether this or an earlier judgement that something moved foretold what was seen
            after it.
    """

    probabilities: dict[str, float]
    best: Part
    x: FloatArray
    beside: tuple[float, float, float]
    misfit: float
    since: float
    sightings: int
    confirmed: bool

    @property
    def moved(self) -> bool:
        """Whether a part rather moved than not, and that explains what is seen."""
        return self.nothing < STILL_LIKELY and self.misfit < MISFIT

    @property
    def nothing(self) -> float:
        """Probability that nothing moved."""
        return self.probabilities[NOTHING]
