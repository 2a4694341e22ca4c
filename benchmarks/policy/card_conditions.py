"""What a policy meets in the cells of a score card, and what becomes of its observations there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from policy.sights import CONDITIONS, Condition, as_taken

Arrays = dict[str, np.ndarray]
IMAGES = "observation.images."

_PLAIN = Condition("as served")


@dataclass(frozen=True)
class CardCondition:
    """What a policy meets.

    Attributes:
        name: In the card.
        sight: What becomes of pictures, camera, places and looks.
        zeroed: All observations are zero.
        delay: Of its answers, in grid times of 50 ms.
        only: Task to which it belongs; empty: all.
    """

    name: str
    sight: Condition = _PLAIN
    zeroed: bool = False
    delay: int = 0
    only: str = ""

    @property
    def blind(self) -> bool:
        """What is observed says nothing, or no picture does."""
        return self.zeroed or self.sight.blind

    def applies(self, task: str, pictures: bool) -> bool:
        """Whether it changes anything in a task, for a policy that reads pictures or none."""
        sight = self.sight
        seen = sight.eye is not as_taken or sight.aside or sight.turn or sight.randomization
        return self.only in ("", task) and (pictures or not seen)


_SIGHTS = {each.name: each for each in CONDITIONS}
QUICK = (
    CardCondition("as served"),
    CardCondition("black pictures", _SIGHTS["black"]),
    CardCondition("frozen pictures", _SIGHTS["first picture frozen"]),
    CardCondition("zeroed observations", zeroed=True),
)
_SHIFTS = (
    *("light 60 %", "light 30 %", "smoke, up to 50 %", "a smudge on the lens", "blur, 4 px"),
    *("camera moved 10 mm", "camera moved 20 mm", "camera turned 10°"),
    *("drawn appearance, camera where it was", "a third instrument in front"),
)
FULL = (
    *QUICK,
    CardCondition("answers 100 ms late", delay=2),
    CardCondition("answers 250 ms late", delay=5),
    *(CardCondition(name, _SIGHTS[name]) for name in _SHIFTS),
    CardCondition("nodes 14 to 16", _SIGHTS["nodes 14 to 16"], only="bgr"),
    CardCondition("nodes 23 to 25", _SIGHTS["nodes 23 to 25"], only="bgr"),
)
BY_NAME = {each.name: each for each in FULL}


class Eye:
    """What becomes of an episode's observations under a condition."""

    def __init__(self, condition: CardCondition, seed: int) -> None:
        self._condition, self._seed = condition, seed
        self._filters: dict[str, Any] = {}

    def __call__(self, arrays: Arrays) -> Arrays:
        """What is sent in their place."""
        if self._condition.zeroed:
            return {key: np.zeros_like(array) for key, array in arrays.items()}
        return {
            key: self._filter(key)(array) if key.startswith(IMAGES) else array
            for key, array in arrays.items()
        }

    def _filter(self, key: str) -> Any:
        if key not in self._filters:  # both eyes meet the same
            made = self._condition.sight.eye
            assert made is not None  # of every condition of a card
            self._filters[key] = made(np.random.default_rng(self._seed))
        return self._filters[key]
