"""Action chunking: when to query a policy again, and how overlapping chunks blend.

Rows are keyed by absolute step, so the computing time of a policy shifts nothing.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from surg_policy_client.attention import Attention
from surg_policy_client.observation import Chunk, Observation


class ChunkBlender:
    """Blends the predictions of several chunks for the same step.

    Args:
        decay: The weight of a prediction is exp(-decay · n), n counting from the oldest one for
            its step, as in ACT's temporal ensemble. None: only the newest counts. Angles are
            blended as numbers, so they must not wrap at ±π; the platform's do not.
    """

    def __init__(self, decay: float | None = None) -> None:
        if decay is not None and not 0.0 <= decay < np.inf:
            raise ValueError(f"decay: {decay!r}; allowed: None, or a number of at least 0")
        self._decay = decay
        self._chunks: list[tuple[int, np.ndarray]] = []

    def clear(self) -> None:
        """Forget all chunks; a new episode begins."""
        self._chunks.clear()

    def add(self, step0: int, rows: np.ndarray) -> None:
        """Add rows [K, A] from a step on."""
        rows = np.asarray(rows, dtype=np.float64)
        if rows.ndim != 2 or (self._chunks and rows.shape[1] != self._chunks[0][1].shape[1]):
            raise ValueError(
                f"rows of shape {rows.shape}; allowed: [K, A], with the same A every time"
            )
        self._chunks.append((step0, rows))

    def rows_from(self, step: int) -> np.ndarray:
        """Blended rows [n, A] from a step on; forgets chunks that end before it."""
        self._chunks = [(s, rows) for s, rows in self._chunks if s + len(rows) > step]
        blended: list[np.ndarray] = []
        while True:
            at = step + len(blended)
            predictions = [rows[at - s] for s, rows in self._chunks if s <= at < s + len(rows)]
            if not predictions:
                break
            if self._decay is None:
                blended.append(predictions[-1])
            else:
                weights = np.exp(-self._decay * np.arange(len(predictions)))
                blended.append(weights @ np.array(predictions) / weights.sum())
        width = self._chunks[0][1].shape[1] if self._chunks else 0
        return np.array(blended).reshape(len(blended), width)


class RecedingHorizon:
    """Queries a policy every few steps and sends nothing new in between.

    The server executes a chunk only while its observation is not older than ``max_obs_age_s`` of
    WELCOME (0.6 s by default: 12 steps at 20 Hz). Keep `every` below that.

    Args:
        policy: With an ``act`` that returns a `Chunk` or rows [K, A].
        every: Steps between two queries.
        decay: See `ChunkBlender`.
    """

    def __init__(self, policy: Any, every: int, decay: float | None = None) -> None:
        if every < 1:
            raise ValueError(f"every: {every!r}; allowed: 1 or more")
        self._policy, self._every = policy, every
        self._blender = ChunkBlender(decay)
        self._queried: int | None = None
        self._fresh = False
        self.wants = getattr(policy, "wants", None)
        self.name = getattr(policy, "name", type(policy).__name__)

    def reset(self, instruction: str, seed: int | None) -> None:
        """A new episode."""
        self._blender.clear()
        self._queried = None
        if hasattr(self._policy, "reset"):
            self._policy.reset(instruction, seed)

    def seen(self) -> Attention | None:
        """What the policy saw, if it was queried for the last observation."""
        return self._policy.seen() if self._fresh and hasattr(self._policy, "seen") else None

    def act(self, observation: Observation) -> Chunk | None:
        """Rows from the next step on if the policy was queried, else None."""
        step = observation.step
        # A slow policy misses steps, so count those that have passed.
        self._fresh = self._queried is None or not 0 <= step - self._queried < self._every
        if not self._fresh:
            return None
        self._queried = step
        answer = self._policy.act(observation)
        chunk = answer if isinstance(answer, Chunk) else Chunk(np.asarray(answer))
        self._blender.add(step + 1 if chunk.step0 is None else chunk.step0, chunk.rows)
        return Chunk(self._blender.rows_from(step + 1), step + 1)
