"""What a policy sees, and what it answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Mapping

import numpy as np

from surg_policy_client.errors import BadAction, SpecMismatch
from surg_policy_client.spec import Spec
from surg_policy_client.wire import Message

STATE = "observation.state"
_HELD = {"x": "set_x", "y": "set_y", "z": "set_z", "roll": "roll_set", "jaw": "jaw"}
"""Column of the state that an action keeps where it is."""


@dataclass(frozen=True)
class Observation:
    """One observation. Arrays are read-only views: copy what is to be changed.

    Attributes:
        arrays: By key of the spec, such as ``observation.state``.
        step: Number of the grid time it stands at.
        stamp_ns: Its time on the server's clock [ns].
        episode: Number of the episode.
        instruction: The task in words.
        spec: What the numbers mean.
        seq: The server's number of it.
        session: Of the session it belongs to.
    """

    arrays: Mapping[str, np.ndarray]
    step: int
    stamp_ns: int
    episode: int
    instruction: str
    spec: Spec
    seq: int = 0
    session: int = 0

    @classmethod
    def of(cls, message: Message, spec: Spec) -> Observation:
        """Of an OBS.

        Raises:
            SpecMismatch: It is not what the server said that it serves.
        """
        if wrong := spec.check_observation(message.arrays):
            raise SpecMismatch(f"an observation is not as the server's spec: {'; '.join(wrong)}")
        head = message.head
        return cls(
            message.arrays,
            head["step"],
            head["stamp_ns"],
            head["episode"],
            head["instruction"],
            spec,
            head["seq"],
            head["session"],
        )

    def __getitem__(self, key: str) -> np.ndarray:
        """An array by its key."""
        return self.arrays[key]

    def named(self, name: str, key: str = STATE) -> float:
        """One number of a vector by its name, such as ``PSM1/tip_x``.

        Raises:
            KeyError: When the spec names no such number.
        """
        names = self.spec.observation[key].names or ()
        if name not in names:
            raise KeyError(f"{key} has no {name!r}; it has {', '.join(names)}")
        return float(self.arrays[key][names.index(name)])

    def held_action(self) -> np.ndarray:
        """The action [A] that leaves set-point, roll and jaw where they are.

        Raises:
            KeyError: When `observation.state` is not served, or does not say it.
        """
        if STATE not in self.arrays or self.spec.action is None:
            raise KeyError(f"holding needs {STATE}: name it in `wants`")
        found = []
        for name in self.spec.action.names:
            arm, _, part = name.rpartition("/")
            column = _HELD.get(part, part)
            found.append(self.named(f"{arm}/{column}" if arm else column))
        return np.array(found)


@dataclass(frozen=True)
class Chunk:
    """Actions for consecutive grid times.

    Attributes:
        rows: [K, A]; row i is where set-point and jaw shall be at grid time step0 + i.
        step0: Default: the grid time after the observation's.
    """

    rows: np.ndarray
    step0: int | None = None


def as_message(answer: Any, observation: Observation) -> Message:
    """What a policy returned as an ACT.

    Args:
        answer: A `Chunk`; rows [K, A]; one row [A]; None: what was sent before goes on.
        observation: What it answers.

    Raises:
        BadAction: When it is no chunk of the spec's actions: nothing may be sent.
    """
    action = observation.spec.action
    width = len(action.names) if action is not None else 0
    if answer is None:
        answer = np.empty((0, width))
    chunk = answer if isinstance(answer, Chunk) else Chunk(np.asarray(answer))
    rows = np.asarray(chunk.rows)
    if rows.dtype.kind not in "fiu":
        raise BadAction(f"actions are numbers, not {rows.dtype}")
    rows = rows.astype(np.float32 if rows.dtype == np.float32 else np.float64, copy=False)
    rows = rows[np.newaxis] if rows.ndim == 1 else rows
    wrong = observation.spec.check_chunk(rows)
    if wrong:
        raise BadAction(f"the answer to step {observation.step} is no chunk: {'; '.join(wrong)}")
    head = {
        "session": observation.session,
        "seq": observation.seq,
        "stamp_ns": observation.stamp_ns,
        "step0": observation.step + 1 if chunk.step0 is None else int(chunk.step0),
    }
    return Message("ACT", head, {"chunk": rows})
