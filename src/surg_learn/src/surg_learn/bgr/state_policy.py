"""A learned policy for bowel grasping and retraction: numpy only, no platform, no torch.

    python3 -m surg_learn.bgr.state_policy --weights weights.npz --server tcp://127.0.0.1:5555

`train_state.py` writes the weights. The policy reads `observation.state`, which a robot measures,
and `privileged.task_state`, the simulator's ground truth: **no robot can measure that**, so this
policy works in the phantom only. It answers each observation with a chunk of actions for the next
steps.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from surg_learn.bgr.observed_features import LAGS, Columns, features
from surg_learn.cloning.arm_columns import SET, STATE, TASK
from surg_learn.cloning.chunk_policy import ChunkPolicy
from surg_learn.cloning.serve_policy import serve


class Policy(ChunkPolicy):
    """A network with its scales, column names and provenance."""

    format = "surg_bgr_policy/1"
    trainer = "train_state.py"
    past = max(LAGS) + 1
    wants = (STATE, TASK)

    def _find_columns(self) -> Any:
        return Columns(self.names[STATE], self.names[TASK])

    def act(self, observation: Any) -> np.ndarray | None:
        """The next actions, (K, 5), from an observation (`surg_policy_client.Observation`).

        None: those of before go on. The server executes the first action of the chunk and asks
        again at the next step.
        """
        arrays = self.see(observation)
        state, task = (np.asarray(arrays[key], np.float64).ravel() for key in (STATE, TASK))
        last = self.last_command(state[self._columns.state][SET], observation)
        self._past.append((state, task, last))
        states, tasks, lasts = (np.array(part) for part in zip(*self._past, strict=True))
        inputs = features(self._columns, states, tasks, lasts, self.scales["X_RW"])[-1:]
        return self.say(self.predict(inputs, last[None])[0], observation)


if __name__ == "__main__":
    sys.exit(serve(Policy, (__doc__ or "").split("\n")[0]))
