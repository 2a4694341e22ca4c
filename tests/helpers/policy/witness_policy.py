"""`nudge_policy.py` that keeps account of what it saw: `python witness_policy.py --server ADDRESS`.

Into the file that `WITNESS` names goes one line per observation: step, stamp, and the checksum of
the left picture.
"""

from __future__ import annotations

import os
import sys
import zlib

from nudge_policy import Nudge

from surg_policy_client import Chunk, Observation
from surg_policy_client.policies.command_line import run

PICTURE = "observation.images.endoscope.left"
WITNESS = "SURG_TEST_WITNESS"


class Witness(Nudge):
    """Three steps at a time, and a line."""

    wants = ("observation.state", PICTURE)

    def act(self, observation: Observation) -> Chunk:
        """The coming steps."""
        seen = zlib.crc32(observation.arrays[PICTURE].tobytes())
        with open(os.environ[WITNESS], "a", encoding="utf-8") as account:
            account.write(f"{observation.step} {observation.stamp_ns} {seen}\n")
        return super().act(observation)


if __name__ == "__main__":
    sys.exit(run(lambda options: Witness(), __doc__))
