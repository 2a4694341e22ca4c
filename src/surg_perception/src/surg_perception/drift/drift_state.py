"""A verdict in words: steady, moved, or why nobody can tell."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from operator import itemgetter

from surg_perception.drift.drift_verdict import MISFIT, NOTHING, STILL_LIKELY, Verdict

STEADY, MOVED, UNKNOWN = "steady", "moved", "cannot tell"
SURE = 0.95
"""Probability from which it is said that something moved."""
LIKELY = 0.8
"""Probability from which a kind of part is named as the cause."""
FAR = 0.001
"""[m] Surely this far beside their place, nothing that trusts the picture may begin."""


@dataclass(frozen=True)
class DriftState:
    """What is known now.

    Attributes:
        word: `STEADY`, `MOVED` or `UNKNOWN`.
        reason: Why nobody can tell, or which parts could have moved; empty: steady.
        cause: Name of the part that moved, or of those of one kind that nobody can tell apart, as
            in ``base of PSM1 or base of ECM``; empty: nothing did, or which kind is open.
        likely: Probability of the cause's kind.
        beside: Least, expected and largest distance between where instruments are seen and where
            joints put them [m], 95 %; zeros: unknown.
        since: Stamp from which on it holds [s].
    """

    word: str
    reason: str = ""
    cause: str = ""
    likely: float = 0.0
    beside: tuple[float, float, float] = (0.0, 0.0, 0.0)
    since: float = 0.0

    @property
    def far(self) -> bool:
        """Whether the picture is not to be trusted any more."""
        return self.word == MOVED and self.beside[0] > FAR

    def sentence(self) -> str:
        """For people."""
        if self.word == UNKNOWN:
            return f"{UNKNOWN}: {self.reason}"
        low, expected, high = (f"{1e3 * value:.1f}" for value in self.beside)
        seen = f"instruments are seen {expected} mm beside their place (95 %: {low} to {high} mm)"
        if self.word == STEADY:
            return f"{STEADY}: {seen}"
        cause = f"{self.cause} ({100 * self.likely:.0f} %)" if self.cause else self.reason
        return f"{MOVED}: {seen}; cause: {cause}"


def state_of(verdict: Verdict | None, unseen: Counter[str]) -> DriftState:
    """The state of a verdict.

    Args:
        verdict: Of the newest sightings; None: there are too few.
        unseen: Why instruments were not seen, and how often.
    """
    if verdict is None:
        why = unseen.most_common(1)
        seen = f"too few sightings ({why[0][0]})" if why else "no instrument has moved in view yet"
        return DriftState(UNKNOWN, seen)
    word = MOVED if verdict.nothing < 1.0 - SURE and verdict.confirmed else UNKNOWN
    if verdict.nothing > STILL_LIKELY:
        word = STEADY
    reason, cause, likely = "", "", 0.0
    if verdict.misfit > MISFIT:
        word, reason = UNKNOWN, "what is seen does not move as the joints say"
    elif word == UNKNOWN:
        reason = "the newest sightings disagree with older ones, too few to be sure"
    elif word == MOVED:
        moved = {name: p for name, p in verdict.probabilities.items() if name != NOTHING}
        kinds = dict[str, float]()
        for name, p in moved.items():
            kinds[name.split()[0]] = kinds.get(name.split()[0], 0.0) + p / sum(moved.values())
        kind, likely = max(kinds.items(), key=itemgetter(1))
        if likely < LIKELY:
            reason = f"{_most_of(moved)}; turn the endoscope to tell them apart"
        else:
            cause = _most_of({name: p for name, p in moved.items() if name.split()[0] == kind})
    return DriftState(word, reason, cause, likely, verdict.beside, verdict.since)


def _most_of(probabilities: dict[str, float]) -> str:
    """Names of the most probable parts, so many that one of them is it, surely."""
    names, held = list[str](), 0.0
    for name, p in sorted(probabilities.items(), key=itemgetter(1), reverse=True):
        names.append(name)
        held += p
        if held >= SURE * sum(probabilities.values()):
            break
    return " or ".join(names)
