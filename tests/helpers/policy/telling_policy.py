"""The circle that says what it sees: `python telling_policy.py --server ADDRESS`.

Every tenth time it says something wrong, which must do no harm.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from circle_policy import Circle

from surg_policy_client import Attention, Chunk, Keypoint, Observation, serve
from surg_policy_client import attention as sights


class Telling(Circle):
    """A circle; its step stands in the first keypoint."""

    _step = 0

    def act(self, observation: Observation) -> Chunk:
        """See `Circle`."""
        self._step = observation.step
        return super().act(observation)

    def seen(self) -> Attention:
        """A point that goes to the right with every step."""
        share = self._step % 100 / 100
        return Attention(
            (Keypoint("tip", share, 0.25, 0.5),),
            phase="x" * 33 if self._step % 10 == 0 else "round",
            confidence=0.75,
            picture="observation.images.endoscope.left",
            heat_map=np.full((2, 3), self._step % 256, np.uint8),
        )


def main() -> None:
    """Serve, without the client's own check."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--server", required=True)
    options = parser.parse_args()
    sights.from_wire = lambda head, attention: None  # type: ignore[assignment]
    serve(Telling(0.05, 10), options.server)


if __name__ == "__main__":
    main()
