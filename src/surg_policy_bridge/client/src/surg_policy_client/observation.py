"""Observations and actions of a policy."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Mapping

import numpy as np

from surg_policy_client.action_spec import CHANGES
from surg_policy_client.errors import BadAction, SpecMismatch
from surg_policy_client.spec import Spec
from surg_policy_client.wire import Message

STATE = "observation.state"
RCM = "observation.rcm_frame"
HELD = ("set_{}", "{}_set", "{}")
"""Columns of the state, the first that there is, with the present value of an action's column."""


@dataclass(frozen=True)
class Observation:
    """One observation. Arrays are read-only views; copy before you change them.

    Attributes:
        arrays: By key of the spec, such as ``observation.state``.
        step: Number of its grid time.
        stamp_ns: Its time on the server's clock [ns].
        episode: Number of the episode.
        instruction: The task in words.
        spec: Names, units and shapes.
        seq: Sequence number of the server.
        session: Number of its session.
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
        """From an OBS message.

        Raises:
            SpecMismatch: It does not match the server's specification.
        """
        if wrong := spec.check_observation(message.arrays):
            raise SpecMismatch(
                f"an observation does not match the server's spec: {'; '.join(wrong)}"
            )
        return cls(message.arrays, spec=spec, **message.head)

    def __getitem__(self, key: str) -> np.ndarray:
        """Array by key.

        Raises:
            KeyError: It is not served.
        """
        if key not in self.arrays:
            there = ", ".join(self.arrays)
            raise KeyError(f"{key}: not served; name it in `wants`; there are {there}")
        return self.arrays[key]

    def named(self, name: str, key: str = STATE) -> float:
        """One number of a vector by its name, such as ``PSM1/tip_x``.

        Raises:
            KeyError: The spec has no such name.
        """
        names = self.spec.observation[key].names or ()
        if name not in names:
            raise KeyError(f"{key} has no {name!r}; it has {', '.join(names)}")
        return float(self.arrays[key][names.index(name)])

    def to_world(self, p_R: Any, arm: str | None = None) -> np.ndarray:
        """Points (…, 3) [m] of an arm's rcm frame, in the world.

        Args:
            p_R: The points.
            arm: Its name; None: the first one.

        Raises:
            KeyError: `observation.rcm_frame` is not in `wants`, or there is no such arm.
        """
        X_WR = self._rcm_frame(arm)
        return np.asarray(p_R) @ X_WR[:3, :3].T + X_WR[:3, 3]

    def to_rcm(self, p_W: Any, arm: str | None = None) -> np.ndarray:
        """Points (…, 3) [m] of the world, in an arm's rcm frame; as `to_world`."""
        X_WR = self._rcm_frame(arm)
        return (np.asarray(p_W) - X_WR[:3, 3]) @ X_WR[:3, :3]

    def _rcm_frame(self, arm: str | None) -> np.ndarray:
        names = self.spec.action.names if self.spec.action is not None else ()
        arms = list(dict.fromkeys(name.rpartition("/")[0] for name in names))
        if RCM not in self.arrays:
            raise KeyError(f"the world needs {RCM}: name it in `wants`")
        if arm is not None and arm not in arms:
            raise KeyError(f"there is no arm {arm!r}; there are {', '.join(arms)}")
        return self.arrays[RCM][0 if arm is None else arms.index(arm)]

    def held_action(self) -> np.ndarray:
        """The action [A] that keeps the arms where they are told to be.

        It is the newest row that was accepted; of an arm at rest its set-point. Count steps from
        here, never from the measured tip, which lags behind.

        Raises:
            KeyError: `observation.state` is not served, or lacks a column.
        """
        if STATE not in self.arrays or self.spec.action is None:
            raise KeyError(f"holding needs {STATE}: name it in `wants`")
        values = []
        for name in self.spec.action.names:
            arm, _, part = name.rpartition("/")
            values.append(self._held(f"{arm}/" if arm else "", part))
        return np.array(values)

    def _held(self, arm: str, part: str) -> float:
        """The value of an action's column that keeps an arm where it is."""
        if part in CHANGES:
            return 0.0
        names = self.spec.observation[STATE].names or ()
        known = [arm + form.format(part) for form in HELD if arm + form.format(part) in names]
        if known or part not in ("yaw", "pitch", "insertion"):
            return self.named(known[0] if known else arm + part)
        x, y, z = (self.named(f"{arm}set_{axis}") for axis in "xyz")
        insertion = math.sqrt(x * x + y * y + z * z)
        joints = {"yaw": math.atan2(x, z), "pitch": math.asin(y / insertion)}
        return joints.get(part, insertion)


@dataclass(frozen=True)
class Chunk:
    """Actions for consecutive grid times.

    Attributes:
        rows: [K, A]; row i holds the targets of grid time step0 + i.
        step0: Default: one after the observation's.
    """

    rows: np.ndarray
    step0: int | None = None


def as_message(answer: Any, observation: Observation) -> Message:
    """The ACT message of a policy's answer.

    Args:
        answer: A `Chunk`, rows [K, A], one row [A], or None (earlier rows stay valid).
        observation: The observation that it answers.

    Raises:
        BadAction: It is not a chunk of the spec's actions.
    """
    action = observation.spec.action
    width = len(action.names) if action is not None else 0
    if answer is None:
        answer = np.empty((0, width))
    chunk = answer if isinstance(answer, Chunk) else Chunk(np.asarray(answer))
    rows = np.asarray(chunk.rows)
    if rows.dtype.kind not in "fiu":
        raise BadAction(f"an action of type {rows.dtype}; allowed: numbers")
    rows = rows.astype(np.float32 if rows.dtype == np.float32 else np.float64, copy=False)
    rows = rows[np.newaxis] if rows.ndim == 1 else rows
    wrong = observation.spec.check_chunk(rows)
    if wrong:
        raise BadAction(f"the answer to step {observation.step} is invalid: {'; '.join(wrong)}")
    head = {
        "session": observation.session,
        "seq": observation.seq,
        "stamp_ns": observation.stamp_ns,
        "step0": observation.step + 1 if chunk.step0 is None else int(chunk.step0),
    }
    return Message("ACT", head, {"chunk": rows})
