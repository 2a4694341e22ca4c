"""What a policy meets in the cells of a score card, and what becomes of its observations there."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from policy import sights
from policy.sights import Filter, Picture, Replayed

from surg_sim.appearance.domain_randomization import DomainRandomization

Arrays = dict[str, np.ndarray]
IMAGES = "observation.images."


@dataclass(frozen=True)
class CardCondition:
    """What a policy meets.

    Attributes:
        name: In the card.
        eye: What becomes of each picture; None: those of another episode are shown.
        blind: What is observed says nothing about this episode.
        zeroed: All observations are zero.
        delay: Of its answers, in grid times of 50 ms.
        setting: Of the patient.
        aside: The camera is moved so far along the picture's rows [m].
        turn: The camera is turned up so far [deg].
        targets: First and last node that the assistant of bgr may point at; None: as trained.
        randomization: Ranges of the looks of each episode; None: as built.
        only: Task to which it belongs; empty: all.
    """

    name: str
    eye: Callable[[np.random.Generator], Filter] | None = sights.as_taken
    blind: bool = False
    zeroed: bool = False
    delay: int = 0
    setting: str = "phantom"
    aside: float = 0.0
    turn: float = 0.0
    targets: tuple[int, int] | None = None
    randomization: DomainRandomization | None = None
    only: str = ""

    def applies(self, task: str, pictures: bool) -> bool:
        """Whether it changes anything in a task, for a policy that reads pictures or none."""
        seen = self.eye is not sights.as_taken or self.aside or self.turn or self.randomization
        return self.only in ("", task) and (pictures or not seen)


_STILL = replace(DomainRandomization(), camera_shift_mm=(0.0, 0.0), camera_turn_deg=(0.0, 0.0))
QUICK = (
    CardCondition("as served"),
    CardCondition("black pictures", sights.black, blind=True),
    CardCondition("frozen pictures", sights.frozen, blind=True),
    CardCondition("another episode's pictures", None, blind=True),
    CardCondition("zeroed observations", zeroed=True, blind=True),
)
FULL = (
    *QUICK,
    CardCondition("answers 100 ms late", delay=2),
    CardCondition("answers 250 ms late", delay=5),
    CardCondition("setting ex_vivo", setting="ex_vivo"),
    CardCondition("setting in_vivo", setting="in_vivo"),
    CardCondition("light 60 %", sights.light(0.6)),
    CardCondition("light 30 %", sights.light(0.3)),
    CardCondition("smoke, up to 50 %", sights.smoke(0.5)),
    CardCondition("a smudge on the lens", sights.smudge),
    CardCondition("blur, 4 px", sights.blur(4.0)),
    CardCondition("camera moved 10 mm", aside=0.010),
    CardCondition("camera moved 20 mm", aside=0.020),
    CardCondition("camera turned 10°", turn=10.0),
    CardCondition("drawn appearance, camera where it was", randomization=_STILL),
    CardCondition("a third instrument in front", sights.instrument),
    CardCondition("nodes 14 to 16", targets=(14, 16), only="bgr"),
    CardCondition("nodes 23 to 25", targets=(23, 25), only="bgr"),
)
BY_NAME = {each.name: each for each in FULL}


class Eye:
    """What becomes of an episode's observations under a condition.

    Args:
        condition: The condition.
        seed: Of the episode.
        others: Pictures of another episode, by key of the observation, for who is shown those.
    """

    def __init__(
        self, condition: CardCondition, seed: int, others: Mapping[str, Sequence[Picture]]
    ) -> None:
        self._condition, self._seed = condition, seed
        self._filters: dict[str, Filter] = {key: Replayed(each) for key, each in others.items()}

    def __call__(self, arrays: Arrays) -> Arrays:
        """What is sent in their place."""
        if self._condition.zeroed:
            return {key: np.zeros_like(array) for key, array in arrays.items()}
        return {
            key: self._filter(key)(array) if key.startswith(IMAGES) else array
            for key, array in arrays.items()
        }

    def _filter(self, key: str) -> Filter:
        if key not in self._filters:  # both eyes meet the same
            assert self._condition.eye is not None
            self._filters[key] = self._condition.eye(np.random.default_rng(self._seed))
        return self._filters[key]
