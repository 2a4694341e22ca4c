"""A learned policy for bowel grasping and retraction from endoscope pictures; numpy only.

    python3 -m surg_learn.bgr.image_policy --weights weights.npz --server tcp://127.0.0.1:5555

`train_images.py` writes the weights. The policy reads `observation.state` and the endoscope's
left picture: **what a robot can measure, and nothing else**. It answers each observation with a
chunk of actions for the next steps. `state_policy.py` does the same from ground truth.

An eye (`keypoint_network`) finds points in the picture, a memory fuses what successive pictures
say, and a hand, a multilayer perceptron, moves relative to these points.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from surg_learn.bgr.keypoint_network import (
    CONVOLUTIONS,
    HELD,
    NEAR,
    OTHER_HELD,
    OTHER_JAW,
    PLACE,
    SAID,
    SEEN,
    TENSION,
    TIP,
    Eye,
)
from surg_learn.bgr.observed_features import LAGS
from surg_learn.bgr.picture_memory import Memory, View
from surg_learn.cloning.arm_columns import SET, STATE
from surg_learn.cloning.chunk_policy import ChunkPolicy, Network
from surg_learn.cloning.serve_policy import serve
from surg_learn.cloning.small_pictures import small

PICTURE = "observation.images.endoscope.left"
EYE_LAYERS = len(CONVOLUTIONS) + 4
"""Layers of the eye; those of the hand follow."""
PLACES, DISTANCE, HERE = slice(0, 6), 6, slice(-3, None)
"""Columns of the features: vectors from the last command to the requested place and the assistant;
the length of the first; the last command."""

STILL = 1e-4
"""A command stands that changes by less in a step [m]."""
AHEAD, SHUT = 2e-3, 0.1
"""A chunk that ends farther from the command in force [m], or with other jaws [rad], moves."""
PATIENCE, KEPT = 20, 8
"""Steps of standing still behind chunks that move, before one is played; so many steps of it."""

TARGET, ALONG, HELPER = (slice(SAID + i, SAID + i + 3) for i in (0, 3, 6))
"""Columns of `Sight` in the rcm frame: where on the bowel the assistant pointed [m], the tube's
direction there, the assistant's tip as if it lay on the bowel [m]."""
CERTAIN, POINTING = SAID + 9, SAID + 10

Array = np.ndarray


class Sight:
    """What an episode's pictures say, fused: memory of the place, shift of the picture.

    Args:
        plane: See `View`.
        lens: See `View`.
    """

    def __init__(self, plane: Array, lens: Array) -> None:
        self._memory, self._view = Memory(), View(plane, lens)
        self.place = np.zeros(2)
        """Where in the picture the assistant pointed: for people who watch."""

    def add(self, answer: Array, p_RTip: Array) -> Array:
        """Take an answer of the eye (SAID,), and the robot's tip (3,) [m].

        Returns:
            (SAID + 11,): the answer, `TARGET`, `ALONG`, `HELPER`, certainty, pointing.
        """
        known = self._memory.add(answer)
        self.place = known[:2]
        self._view.look(answer[TIP], answer[SEEN], p_RTip)
        points = self._view.points(np.array([known[:2], answer[PLACE]]))
        along = self._view.along(known[:2], known[2:4])
        return np.concatenate([answer, points[0], along, points[1], known[4:]])


def remembered(answers: Array, tips: Array, plane: Array, lens: Array) -> Array:
    """Answers of the eye at T successive steps of one episode, with what `Sight` makes of them.

    Args:
        answers: (T, SAID) of `Eye`.
        tips: (T, 3) the robot's tip in the rcm frame [m].
        plane: See `View`.
        lens: See `View`.

    Returns:
        (T, SAID + 11).
    """
    sight = Sight(plane, lens)
    return np.array([sight.add(*each) for each in zip(answers, tips, strict=True)])


def features(columns: Array, state: Array, seen: Array, last: Array, moved: Array) -> Array:
    """Inputs of the hand at each of T successive steps of one episode.

    All are in the rcm frame, as the actions are. Before the first step, the first one holds. How
    fast it moves, the hand knows from its own commands: how far the arm is behind them depends on
    delays, and these differ between lock-step and real time.

    Args:
        columns: Of `state_columns`.
        state: (T, 9) `observation.state`.
        seen: (T, SAID + 11) of `remembered`.
        last: (T, 4) tip and roll of the last command; at the first step, the set-point.
        moved: (T, 4) change of ``last`` in one step.

    Returns:
        (T, F). `PLACES` are vectors from the last command, `DISTANCE` is the length of the first,
        and `HERE` is the last command.
    """
    s = state[:, columns]
    here = last[:, :3]
    target, helper = seen[:, TARGET] - here, seen[:, HELPER] - here
    now = [
        target,
        helper,
        np.linalg.norm(target, axis=1),
        seen[:, ALONG],
        moved,
        last[:, 3],
        seen[:, [OTHER_JAW, TENSION, NEAR, CERTAIN, POINTING]],
    ]
    apart = np.linalg.norm(helper - target, axis=1)
    slow = np.column_stack([seen[:, [HELD, OTHER_HELD]], apart, s[:, 4]])
    row = np.arange(len(s))
    past = [slow[np.maximum(row - lag, 0)] for lag in LAGS]
    return np.column_stack([*now, *past, here])


class EyeAndHand:
    """The two networks of the policy.

    Args:
        layers: Of the eye, then of the hand.
        pointed: Of the eye.
    """

    def __init__(self, layers: Sequence[tuple[Array, Array]], pointed: Array) -> None:
        self.layers = list(layers)
        self.eye = Eye(self.layers[:EYE_LAYERS], pointed)
        self.hand = Network(self.layers[EYE_LAYERS:])

    def __call__(self, x: Array) -> Array:
        """The hand: (T, F) to (T, n_out), both normalised."""
        return self.hand(x)


class ImagePolicy(ChunkPolicy):
    """A policy that reads the endoscope's left picture and measured values."""

    format = "surg_bgr_image_policy/4"
    trainer = "train_images.py"
    past = max(LAGS) + 1
    wants = (STATE, PICTURE)
    pictures = (PICTURE,)

    @classmethod
    def network_of(
        cls, layers: Sequence[tuple[Array, Array]], scales: Mapping[str, Array]
    ) -> EyeAndHand:
        """See `ChunkPolicy`."""
        return EyeAndHand(layers, scales["pointed"])

    def reset(self, instruction: str = "", seed: int | None = None) -> None:
        """Forget the last episode."""
        super().reset(instruction, seed)
        self._sight = Sight(self.scales["plane"], self.scales["lens"])
        self._seen: Array | None = None
        self._before: tuple[Array, int | None] | None = None
        self._hesitated = 0

    def act(self, observation: Any) -> Array | None:
        """The next actions, (K, 5), from an observation (`surg_policy_client.Observation`).

        None: those of before go on. Asked at each step, a hand may say for ever that it will move
        in a moment: between two places that call for different actions their mean is to stand. Then
        it keeps to a chunk for some steps.
        """
        arrays = self.see(observation)
        state = np.asarray(arrays[STATE], np.float64).ravel()
        picture = np.asarray(arrays[PICTURE])
        answer = self.network.eye(small(picture)[None])[0]
        seen = self._sight.add(answer, state[self._columns][:3])
        self._seen, self._aspect = seen, picture.shape[0] / picture.shape[1]
        last, moved = self._last_and_moved(state[self._columns][SET], observation)
        self._past.append((state, seen, last, moved))
        parts = [np.array(part) for part in zip(*self._past, strict=True)]
        if self.goes_on(observation):
            return None
        inputs = features(self._columns, *parts)[-1:]
        chunk = self.predict(inputs, last[None])[0]
        self._hesitated = self._hesitated + 1 if _hesitates(chunk, last, moved) else 0
        if self._hesitated > PATIENCE:
            self._hesitated, self._kept = 0, min(KEPT, self.chunk)
        return self.say(chunk, observation)

    def _last_and_moved(self, held: Array, observation: Any) -> tuple[Array, Array]:
        """The last command, and its change in one step: none where the arm begins anew."""
        last = self.last_command(held, observation)
        step = getattr(observation, "step", None)
        before, self._before = self._before, (last, step)
        if before is None or last is held:
            return last, np.zeros(4)
        steps = 1 if step is None or before[1] is None else max(step - before[1], 1)
        return last, (last - before[0]) / steps

    def seen(self) -> Any:
        """What it made of the last picture, a `surg_policy_client.Attention`: for people who watch.

        The map is where it sees the bowel; the confidence is that in the requested place, and once
        it holds the bowel, that in holding it.
        """
        if self._seen is None:
            return None
        from surg_policy_client.attention import Attention, Keypoint

        seen, half = self._seen, self._aspect / 2

        def point(name: str, place: Array, certainty: float) -> Keypoint:
            """From a place in the middle square, down and right, -1 to 1."""
            down, right = np.clip(place, -2.0, 2.0)
            share = float(np.clip(certainty, 0.0, 1.0))
            return Keypoint(name, 0.5 + half * float(right), 0.5 + 0.5 * float(down), share)

        held, helped = (float(seen[column]) for column in (HELD, OTHER_HELD))
        certain = float(seen[CERTAIN])
        holders = [
            name for name, chance in (("robot", held), ("assistant", helped)) if chance > 0.5
        ]
        phase = f"{' and '.join(holders)} hold{'s' * (len(holders) == 1)}" if holders else ""
        return Attention(
            (
                point("tip", seen[TIP], seen[SEEN]),
                point("assistant", seen[PLACE], 1.0),
                point("requested", self._sight.place, certain),
            ),
            phase=phase or ("reaching" if certain > 0.5 else "waiting for a place"),
            confidence=float(np.clip(held if held > 0.5 else certain, 0.0, 1.0)),
            picture=PICTURE,
            heat_map=np.rint(255 * np.clip(self.network.eye.tube, 0, 1)).astype(np.uint8),
            area=(0.5 - half, 0.0, 0.5 + half, 1.0),
        )


def _hesitates(chunk: Array, last: Array, moved: Array) -> bool:
    """Whether the arm stands still behind a chunk (K, 5) that ends elsewhere."""
    first, end = chunk[0], chunk[-1]
    stands = max(np.linalg.norm(moved[:3]), np.linalg.norm(first[:3] - last[:3])) < STILL
    goes = np.linalg.norm(end[:3] - last[:3]) > AHEAD or abs(end[4] - first[4]) > SHUT
    return bool(stands and goes)


if __name__ == "__main__":
    sys.exit(serve(ImagePolicy, (__doc__ or "").split("\n")[0]))
