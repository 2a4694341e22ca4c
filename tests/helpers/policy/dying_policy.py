"""The policy of `nudge_policy.py`, which dies in its third action: `SURG_TEST_DEATH` says how.

Its last words are on standard output. `starts` dies before it has connected.
"""

from __future__ import annotations

import os
import signal
import sys

import numpy as np
from nudge_policy import Nudge

from surg_policy_client import Chunk, Observation
from surg_policy_client.policies.command_line import run

LAST_WORDS = "the weights are gone"
ACTIONS = 3


class Dying(Nudge):
    """Acts twice."""

    def __init__(self) -> None:
        super().__init__()
        self._acted = 0

    def act(self, observation: Observation) -> Chunk:
        """The coming steps, or the end."""
        self._acted += 1
        chunk = super().act(observation)
        if self._acted < ACTIONS:
            return chunk
        print(LAST_WORDS, flush=True)
        return DEATHS[os.environ["SURG_TEST_DEATH"]](chunk)


def _raises(chunk: Chunk) -> Chunk:
    raise ValueError(LAST_WORDS)


def _wrong_shape(chunk: Chunk) -> Chunk:
    return Chunk(chunk.rows[:, :-1])


def _no_numbers(chunk: Chunk) -> Chunk:
    return Chunk(np.full_like(chunk.rows, np.nan))


def _killed(chunk: Chunk) -> Chunk:
    os.kill(os.getpid(), signal.SIGKILL)
    return chunk


def _exits(chunk: Chunk) -> Chunk:
    sys.exit(0)


def _aborts(chunk: Chunk) -> Chunk:
    os.abort()


DEATHS = {
    "raises": _raises,
    "wrong shape": _wrong_shape,
    "no numbers": _no_numbers,
    "killed": _killed,
    "exits": _exits,
    "aborts": _aborts,
}

if __name__ == "__main__":
    if os.environ["SURG_TEST_DEATH"] == "starts":
        raise RuntimeError(LAST_WORDS)
    sys.exit(run(lambda options: Dying(), __doc__))
