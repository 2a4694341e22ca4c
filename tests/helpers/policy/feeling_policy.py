"""`nudge_policy.py` that keeps account of what it felt: `feeling_policy.py --server ADDRESS`.

Into the file that `WITNESS` names goes one line per observation: step and the numbers of
`observation.force`.
"""

from __future__ import annotations

import os
import sys

from nudge_policy import Nudge

from surg_policy_client import Chunk, Observation
from surg_policy_client.policies.command_line import run

FORCE = "observation.force"
WITNESS = "SURG_TEST_WITNESS"


class Feeling(Nudge):
    """Three steps at a time, and a line."""

    wants = ("observation.state", FORCE)

    def act(self, observation: Observation) -> Chunk:
        """The coming steps."""
        felt = " ".join(repr(float(v)) for v in observation.arrays[FORCE])
        with open(os.environ[WITNESS], "a", encoding="utf-8") as account:
            account.write(f"{observation.step} {felt}\n")
        return super().act(observation)


if __name__ == "__main__":
    sys.exit(run(lambda options: Feeling(), __doc__))
