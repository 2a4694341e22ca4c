"""The order of messages by their stamps, and which stamps cannot be true.

A bag states two times of each message: its own stamp, and when the bag received it. The stamp
counts. The other time only tells a message that came late, whose stamp is right, from a clock that
was wrong.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter

from surg_recording.imports.ledger import Ledger
from surg_recording.recording_errors import EpisodeError

Stamps = npt.NDArray[np.int64]

FAR_NS = 1_000_000_000
"""A stamp further off its neighbours than this cannot be used [ns]."""
AHEAD_NS = 2_000_000
"""Noise of the time of reception [ns]."""
NEAR, WIDE = 11, 51
"""Messages whose median is the usual delay: round one message, and on either side of a step."""
STEP_SHARE = 0.2
"""Share by which the delay may change otherwise than the stamps do where a clock was set."""
SAME_RATE = 0.1
"""Share by which the bag's time may run faster or slower than the stamps."""
CURE = "--stamps bag takes the times at which the bag received the messages"


def in_order(stamps: Stamps, received: Stamps, stream: str, ledger: Ledger) -> npt.NDArray[np.intp]:
    """The messages to use, in the order of their stamps, each stamp once.

    Args:
        stamps: Of N messages in the order of their reception [ns].
        received: When the bag received them [ns].
        stream: For the ledger, which counts what is left out.
        ledger: Of the import.

    Raises:
        EpisodeError: The clock of the stamps was set.
    """
    good = np.ones(len(stamps), bool)
    if len(stamps) > 2:
        period = int(np.median(np.abs(np.diff(stamps))))
        delay = (received - stamps).astype(np.float64)
        usual = median_filter(delay, NEAR, mode="reflect")
        wild = np.abs(delay - usual) > max(FAR_NS, NEAR * period)
        good = ledger.sieve(stream, wild, "stamped more than 1 s off their neighbours", good)
        after = np.minimum.accumulate(np.where(good, stamps, np.iinfo(np.int64).max)[::-1])[::-1]
        overtaken = np.append(after[1:] <= stamps[:-1], False)
        ahead = overtaken & (usual - delay > max(AHEAD_NS, period / 2))
        good = ledger.sieve(
            stream, ahead, "stamped ahead of their reception (--stamps bag takes that time)", good
        )
        _refuse_steps(stamps[good], received[good], stream)
    used = np.flatnonzero(good)
    used = used[np.argsort(stamps[used], kind="stable")]
    first = np.diff(stamps[used], prepend=-1) > 0
    ledger.drop(stream, "with the stamp of another message", int((~first).sum()))
    return used[first]


def _refuse_steps(stamps: Stamps, received: Stamps, stream: str) -> None:
    """A clock that was set shifts the delay of all later messages by as much as the stamps."""
    if len(stamps) < 2:
        return
    delay = (received - stamps).astype(np.float64)
    usual, place = median_filter(delay, WIDE, mode="reflect"), np.arange(len(stamps) - 1)
    last = len(stamps) - 1
    before = usual[np.clip(place - WIDE // 2, 0, last)]
    shift = usual[np.clip(place + 1 + WIDE // 2, 0, last)] - before
    gap, period = np.diff(stamps), float(np.median(np.abs(np.diff(stamps))))
    excess = gap - np.diff(received)  # how far the stamps went beyond the bag's time
    alike = np.abs(shift + excess) <= STEP_SHARE * np.abs(excess) + period
    back = (gap <= 0) & alike & (shift > period)
    far_back = np.maximum.accumulate(stamps)[:-1] - stamps[1:] > FAR_NS
    ahead = (excess > FAR_NS) & alike
    if (wrong := back | far_back | ahead).any():
        at = int(np.argmax(wrong))
        way = "ahead" if ahead[at] else "back"
        raise EpisodeError(
            f"{stream}: its stamps step {way} by {abs(gap[at]) * 1e-9:.2f} s after"
            f" {(received[at] - received[0]) * 1e-9:.2f} s (message {at + 2}): the clock was set."
            f" {CURE}"
        )


def lag(stamps: Stamps, received: Stamps) -> float | None:
    """Usual time from the stamp to the reception [ns]; None where the bag's time says nothing."""
    span, seen = int(stamps[-1] - stamps[0]), int(received.max() - received.min())
    if len(stamps) < NEAR or abs(seen - span) > SAME_RATE * span:
        return None
    return float(np.median(received - stamps))


def check_agreement(lags: dict[str, float | None], ledger: Ledger) -> None:
    """Refuse streams whose stamps are of clocks that differ.

    Raises:
        EpisodeError: Names both.
    """
    known = {stream: value for stream, value in lags.items() if value is not None}
    for stream in sorted(set(lags) - set(known)):
        ledger.assume(f"{stream}: its stamps are right; the bag's time runs otherwise")
    if not known:
        return
    low, high = min(known, key=known.__getitem__), max(known, key=known.__getitem__)
    apart = known[high] - known[low]
    if apart > FAR_NS:
        raise EpisodeError(
            f"{high}: its stamps are {apart * 1e-9:.2f} s behind those of {low}, by the times at"
            f" which the bag received both. {CURE}"
        )
