"""Chunks of actions over time: when to ask a policy again, and how overlapping chunks blend.

Everything is keyed by the absolute step, so that nothing is shifted by how long a policy took.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from surg_policy_client.observation import Chunk, Observation


class ChunkBlender:
    """Predictions of several chunks for the same step, as one.

    Args:
        decay: A prediction's weight is exp(-decay · n), n counting from the oldest for its step (as
            in ACT's temporal ensemble: the oldest weighs most). None: the newest alone counts.
            Angles are blended as numbers: they have to continue over ±π, as the platform's do.
    """

    def __init__(self, decay: float | None = None) -> None:
        if decay is not None and not 0.0 <= decay < np.inf:
            raise ValueError(f"decay is None or a number from 0, not {decay!r}")
        self._decay = decay
        self._chunks: list[tuple[int, np.ndarray]] = []

    def clear(self) -> None:
        """Forget everything: a new episode begins."""
        self._chunks.clear()

    def add(self, step0: int, rows: np.ndarray) -> None:
        """Take a chunk.

        Args:
            step0: Step of its first row.
            rows: [K, A].
        """
        rows = np.asarray(rows, dtype=np.float64)
        if rows.ndim != 2 or (self._chunks and rows.shape[1] != self._chunks[0][1].shape[1]):
            raise ValueError(f"rows are [K, A], the same A every time, not {rows.shape}")
        self._chunks.append((step0, rows))

    def rows_from(self, step: int) -> np.ndarray:
        """Blended rows [n, A] for `step` and on, as far as there are any; earlier ones are let go.

        Args:
            step: First step wanted.
        """
        self._chunks = [(s, rows) for s, rows in self._chunks if s + len(rows) > step]
        found: list[np.ndarray] = []
        while True:
            at = step + len(found)
            said = [rows[at - s] for s, rows in self._chunks if s <= at < s + len(rows)]
            if not said:
                break
            if self._decay is None:
                found.append(said[-1])
            else:
                weights = np.exp(-self._decay * np.arange(len(said)))
                found.append(weights @ np.array(said) / weights.sum())
        width = self._chunks[0][1].shape[1] if self._chunks else 0
        return np.array(found).reshape(len(found), width)


class RecedingHorizon:
    """Asks a policy every few steps, and sends what it said; in between nothing new.

    The server executes a chunk only while its observation is young (WELCOME: ``max_obs_age_s``,
    0.6 s by default: 12 steps of 20 Hz), so `every` has to stay below that.

    Args:
        policy: Its ``act`` returns a `Chunk` or rows [K, A].
        every: Steps between two questions.
        decay: As of `ChunkBlender`.
    """

    def __init__(self, policy: Any, every: int, decay: float | None = None) -> None:
        if every < 1:
            raise ValueError(f"every is 1 or more, not {every!r}")
        self._policy, self._every = policy, every
        self._blender = ChunkBlender(decay)
        self._asked: int | None = None
        self.wants = getattr(policy, "wants", None)
        self.name = getattr(policy, "name", type(policy).__name__)

    def reset(self, instruction: str, seed: int | None) -> None:
        """A new episode."""
        self._blender.clear()
        self._asked = None
        if hasattr(self._policy, "reset"):
            self._policy.reset(instruction, seed)

    def act(self, observation: Observation) -> Chunk | None:
        """Rows from the next step on where the policy was asked; None in between."""
        step = observation.step
        # Steps can be missed where the policy is slow: what counts is how many have passed.
        if self._asked is not None and 0 <= step - self._asked < self._every:
            return None
        self._asked = step
        answer = self._policy.act(observation)
        chunk = answer if isinstance(answer, Chunk) else Chunk(np.asarray(answer))
        self._blender.add(step + 1 if chunk.step0 is None else chunk.step0, chunk.rows)
        return Chunk(self._blender.rows_from(step + 1), step + 1)
