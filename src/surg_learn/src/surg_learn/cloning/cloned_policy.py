"""A policy cloned from demonstrations by BC, ACT or MoE-ACT, from endoscope pictures; PyTorch.

    python3 -m surg_learn.cloning.cloned_policy --weights act.npz --server tcp://127.0.0.1:5555

`train_cloned.py` writes the weights, which name their method. The policy reads
`observation.state` and the endoscope's picture or pictures: **what a robot can measure, and nothing
else**. It plays a chunk nearly to its end before it asks the network again, as ACT's authors do
(`play` of its training). Of the episode it remembers what it said. One thread runs it.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch

from surg_learn.cloning.arm_columns import SET, STATE
from surg_learn.cloning.chunk_policy import ChunkPolicy, weights_of, write_weights
from surg_learn.cloning.cloned_networks import Answer, Sizes, network_of
from surg_learn.cloning.serve_policy import serve
from surg_learn.cloning.small_pictures import small

Array = np.ndarray
AGAIN = 8
"""Steps after which it says what is left of a chunk: the model server takes those of 0.6 s."""


def numbers_of(state: Array, last: Array) -> Array:
    """What the networks are told beside the pictures, at T steps.

    Args:
        state: (T, 9) of `state_columns`.
        last: (T, 4) tip and roll of the last command; the actions are relative to it.

    Returns:
        (T, 13): tip and set-point from the last command [m], rolls, jaw [rad], last command.
    """
    here = last[:, :3]
    away = [state[:, :3] - here, state[:, SET][:, :3] - here]
    return np.column_stack([*away, state[:, [3, 8]], last[:, 3], state[:, 4], here])


def scaled(views: Any) -> Any:
    """Input of the encoder from grey levels, (B, 3, side, side)."""
    return (views - 128.0) / 64.0


class ClonedPolicy(ChunkPolicy):
    """See the module.

    Attributes:
        pictures: Keys of the eyes.
    """

    format = "surg_cloned_policy/5"
    trainer = "train_cloned.py"

    def __init__(
        self,
        network: Any,
        scales: Mapping[str, Array],
        names: Mapping[str, Sequence[str]],
        sizes: Sizes,
        about: Mapping[str, Any],
    ) -> None:
        self.sizes, self.pictures = sizes, tuple(about["pictures"])
        self.wants = (STATE, *self.pictures)
        self._play = about["play"]
        super().__init__(network.eval(), scales, names, sizes.chunk, about)

    @property
    def method(self) -> str:
        """One of `cloned_networks.METHODS`."""
        return self.sizes.method

    # --- weights on disk ----------------------------------------------------------------------

    def arrays(self) -> dict[str, Array]:
        """Weights and scales by name."""
        weights = {f"net_{n}": v.cpu().numpy() for n, v in self.network.state_dict().items()}
        return weights | {f"scale_{name}": value for name, value in self.scales.items()}

    @property
    def hash(self) -> str:
        """SHA-256 over weights, scales and play; equal trainings give equal hashes."""
        found = hashlib.sha256(repr((self.sizes, self._play)).encode())
        for name, array in sorted(self.arrays().items()):
            found.update(name.encode() + np.ascontiguousarray(array).tobytes())
        return found.hexdigest()

    def save(self, file: Path) -> None:
        """Write an .npz without pickle."""
        head = {"format": self.format, "names": self.names, "about": self.about}
        write_weights(file, {**head, "sizes": asdict(self.sizes)}, self.arrays())

    @classmethod
    def load(cls, file: Path) -> ClonedPolicy:
        """Read weights.

        Raises:
            ValueError: The file holds no weights of such a policy, or of another action space.
        """
        head, arrays = weights_of(file, cls.format)
        parts: dict[str, dict[str, Array]] = {"net": {}, "scale": {}}
        for name, array in arrays.items():
            kind, _, of = name.partition("_")
            parts[kind][of] = array
        try:
            sizes = Sizes(**head["sizes"])
            network = network_of(sizes)
            network.load_state_dict({n: torch.from_numpy(a) for n, a in parts["net"].items()})
        except (TypeError, RuntimeError) as error:
            why = str(error).splitlines()[0]
            raise ValueError(f"{file}: weights of another network ({why})") from None
        return cls(network, parts["scale"], head["names"], sizes, head["about"])

    # --- acting -------------------------------------------------------------------------------

    def reset(self, instruction: str = "", seed: int | None = None) -> None:
        """Forget the last episode."""
        super().reset(instruction, seed)
        self._told = 0

    def answer(self, views: Sequence[Array], state: Array, last: Array) -> Answer:
        """What the network says of B observations.

        Args:
            views: (B, SIDE, SIDE, 3), uint8, of each eye.
            state: (B, 9) of `state_columns`.
            last: (B, 4) last commands.
        """
        x = (numbers_of(state, last) - self.scales["input_mean"]) / self.scales["input_std"]
        device = next(self.network.parameters()).device
        with torch.inference_mode():
            seen = [torch.from_numpy(np.array(v)).to(device).permute(0, 3, 1, 2) for v in views]
            numbers = torch.from_numpy(x.astype(np.float32)).to(device)
            answer: Answer = self.network([scaled(v.float()) for v in seen], numbers)
        return answer

    def act(self, observation: Any) -> Array | None:
        """The next actions, (K, 5), from an observation (`surg_policy_client.Observation`).

        None: those of before go on. A policy that asks at each step starts from rest each time: it
        says a first small step again and again, and never leaves.
        """
        if self.goes_on(observation):
            return self._rest(observation)
        self._kept = min(self._play, self.chunk)
        arrays = self.see(observation)
        state = np.asarray(arrays[STATE], np.float64).ravel()[self._columns]
        held = state[SET]
        last = self.last_command(held, observation)
        views = [small(np.asarray(arrays[key]))[None] for key in self.pictures]
        said = self.answer(views, state[None], last[None]).chunk.cpu().numpy()
        chunk = self.actions(said, last[None])[0]
        self._told = self._asked
        return self.say(chunk, observation)

    def _rest(self, observation: Any) -> Array | None:
        """What is left of the chunk that goes on, every few steps; None in between."""
        now = self._count - 1
        if self._said is None or now - self._told < AGAIN:
            return None
        self._told = now
        # Without grid times the rows that were played are gone already.
        left = 0 if getattr(observation, "step", None) is None else now - self._asked
        return self._said[left:]


if __name__ == "__main__":
    torch.set_num_threads(1)
    sys.exit(serve(ClonedPolicy, (__doc__ or "").split("\n")[0]))
