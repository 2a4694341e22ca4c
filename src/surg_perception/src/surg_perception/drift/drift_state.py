"""A verdict in words: steady, moved, or why nobody can tell."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from surg_perception.drift.drift_evidence import NOTHING, STILL_LIKELY, Verdict

STEADY, MOVED, UNKNOWN = "steady", "moved", "cannot tell"
SURE = 0.95
"""Probability from which it is said that something moved, and a kind of part is named."""
FAR = 0.001
"""[m] Surely this far beside their place, nothing that trusts the picture may begin."""
EXPLAINED = 0.5
"""Least share of sightings that the best hypothesis explains, so that anybody can tell."""


@dataclass(frozen=True)
class DriftState:
    """What is known now.

    Attributes:
        word: `STEADY`, `MOVED` or `UNKNOWN`.
        reason: Why nobody can tell, or which parts could have moved; empty: steady.
        cause: Name of the part that moved, or of those of one kind that nobody can tell apart, as
            in ``base of PSM1 or base of ECM``; empty: nothing did, or which kind is open.
        beside: Least, expected and largest distance between where instruments are seen and where
            joints put them [m], 95 %; zeros: unknown.
        since: Stamp from which on it holds [s].
    """

    word: str
    reason: str = ""
    cause: str = ""
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
        return f"{MOVED}: {seen}; cause: {self.cause or self.reason}"


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
    word = MOVED if verdict.nothing < 1.0 - SURE else UNKNOWN
    if verdict.nothing > STILL_LIKELY:
        word = STEADY
    reason, cause = "", ""
    if verdict.right < EXPLAINED:
        word, reason = UNKNOWN, "what is seen does not move as the joints say"
    elif word == UNKNOWN:
        reason = "the newest sightings disagree with older ones, too few to be sure"
    elif word == MOVED:
        cause, reason = _cause(verdict)
    return DriftState(word, reason, cause, verdict.beside, verdict.since)


def _cause(verdict: Verdict) -> tuple[str, str]:
    """What moved, if it is of one kind; else which parts could have, most probable first."""
    moved = {name: p for name, p in verdict.probabilities.items() if name != NOTHING}
    total = sum(moved.values())
    names, held = list[str](), 0.0
    for name, p in sorted(moved.items(), key=lambda item: -item[1]):
        names.append(name)
        held += p / total
        if held >= SURE:
            break
    if len({name.split()[0] for name in names}) == 1:
        return " or ".join(names), ""
    return "", f"{' or '.join(names)}; turn the endoscope to tell them apart"
