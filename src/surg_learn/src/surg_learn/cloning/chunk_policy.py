"""What all learned policies are: weights on disk, and chunks of actions of one arm.

Numpy only: no platform, no torch.
"""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from surg_learn.cloning.arm_columns import ACTION, STATE, Array, arm_of, state_columns

REACH = 0.02
"""The arm cannot be following a command farther than this from the set-point [m]."""


class Network:
    """A multilayer perceptron with ReLU; weights (n_in, n_out) and biases, float32."""

    def __init__(self, layers: Sequence[tuple[np.ndarray, np.ndarray]]) -> None:
        self.layers = list(layers)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """(T, n_in) to (T, n_out), both normalised."""
        for weight, bias in self.layers[:-1]:
            x = np.maximum(x @ weight + bias, 0.0)
        weight, bias = self.layers[-1]
        return x @ weight + bias


def weights_of(file: Path, form: str) -> tuple[dict[str, Any], dict[str, Array]]:
    """Head and arrays of a file of weights.

    Raises:
        ValueError: The file holds no weights of this format, or of another action space.
    """
    try:
        with np.load(file, allow_pickle=False) as found:
            arrays = {name: found[name] for name in found.files}
        head = json.loads(arrays.pop("head").tobytes())
    except (KeyError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"{file}: no weights of this policy ({error})") from None
    if not isinstance(head, dict) or head.get("format") != form:
        raise ValueError(f"{file}: its format is not {form}")
    try:
        arm_of(head["names"][ACTION])
    except ValueError as error:
        raise ValueError(f"{file}: trained on {error}") from None
    return head, arrays


def write_weights(file: Path, head: Mapping[str, Any], arrays: Mapping[str, Array]) -> None:
    """Write what `weights_of` reads, without pickle; whole or not at all."""
    text = np.frombuffer(json.dumps(head, sort_keys=True).encode(), np.uint8)
    whole = file.with_name(f".{file.name}.partial")
    with whole.open("wb") as stream:
        np.savez(stream, head=text, **arrays)
    whole.replace(file)


class ChunkPolicy:
    """A network with its scales, column names and provenance.

    Attributes:
        format: Of its files of weights.
        trainer: File name of the program that writes them.
        wants: Observation keys.
        pictures: Those of the keys that are pictures.
        chunk: Actions per answer, K.
        about: Dataset, options and losses of the training.
        arm: That it commands.
        past: Observations that it remembers.
    """

    format: str
    trainer: str
    wants: tuple[str, ...]
    pictures: tuple[str, ...] = ()
    past = 1

    def __init__(
        self,
        network: Any,
        scales: Mapping[str, np.ndarray],
        names: Mapping[str, Sequence[str]],
        chunk: int,
        about: Mapping[str, Any],
    ) -> None:
        self.network, self.scales, self.chunk = network, dict(scales), chunk
        self.names = {key: list(value) for key, value in names.items()}
        self.about = dict(about)
        self.arm = arm_of(self.names[ACTION])
        self._checked = False
        self._columns = self._find_columns()
        self.reset()

    def shape_of(self, key: str) -> tuple[int, ...] | None:
        """Shape of an observation in the training, of a picture; None: any."""
        size = self.about.get("dataset", {}).get("picture") if key in self.pictures else None
        return None if size is None else tuple(size)

    def _find_columns(self) -> Any:
        """Columns of the observations.

        Raises:
            ValueError: A required column is missing.
        """
        return state_columns(self.names[STATE], self.arm)

    # --- weights on disk ----------------------------------------------------------------------

    def save(self, file: Path) -> None:
        """Write an .npz without pickle."""
        head = {
            "format": self.format,
            "names": self.names,
            "chunk": self.chunk,
            "about": self.about,
        }
        arrays = {f"scale_{name}": value for name, value in self.scales.items()}
        for i, (weight, bias) in enumerate(self.network.layers):
            arrays[f"weight_{i}"], arrays[f"bias_{i}"] = weight, bias
        write_weights(file, head, arrays)

    @classmethod
    def load(cls, file: Path) -> ChunkPolicy:
        """Read weights.

        Raises:
            ValueError: The file holds no weights of this policy.
        """
        head, arrays = weights_of(file, cls.format)
        count = sum(name.startswith("weight_") for name in arrays)
        layers = [(arrays[f"weight_{i}"], arrays[f"bias_{i}"]) for i in range(count)]
        scales = {n[6:]: value for n, value in arrays.items() if n.startswith("scale_")}
        network = cls.network_of(layers, scales)
        return cls(network, scales, head["names"], head["chunk"], head["about"])

    @classmethod
    def network_of(
        cls, layers: Sequence[tuple[np.ndarray, np.ndarray]], scales: Mapping[str, np.ndarray]
    ) -> Any:
        """The network of a file's layers."""
        del scales
        return Network(layers)

    @property
    def hash(self) -> str:
        """SHA-256 over weights and scales; equal trainings give equal hashes."""
        found = hashlib.sha256()
        for array in [a for layer in self.network.layers for a in layer]:
            found.update(np.ascontiguousarray(array).tobytes())
        for name in sorted(self.scales):
            found.update(np.ascontiguousarray(self.scales[name]).tobytes())
        return found.hexdigest()

    # --- acting -------------------------------------------------------------------------------

    def reset(self, instruction: str = "", seed: int | None = None) -> None:
        """Forget the last episode. The policy is deterministic and knows one task."""
        del instruction, seed
        self._said: np.ndarray | None = None
        self._said_at: int | None = None
        self._count = self._asked = self._kept = self._late = 0
        self._past: deque[tuple[np.ndarray, ...]] = deque(maxlen=self.past)

    def act(self, observation: Any) -> np.ndarray | None:
        """The next actions, (K, 5); None: those of before go on."""
        raise NotImplementedError

    def predict(self, inputs: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Chunks of actions for features.

        Args:
            inputs: (T, F) of `features`.
            last: (T, 4) tip and roll of the last command; actions are relative to it.

        Returns:
            (T, K, 5) tip [m], roll [rad], jaw [rad]; absolute.
        """
        scales = self.scales
        x = (inputs - scales["input_mean"]) / scales["input_std"]
        return self.actions(self.network(x.astype(np.float32)), last)

    def actions(self, outputs: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Actions from the network's outputs (T, n_out); see `predict`."""
        scales = self.scales
        y = outputs.astype(np.float64) * scales["output_std"] + scales["output_mean"]
        y = y.reshape(len(y), -1, 5)[:, : self.chunk]
        y[:, :, :4] += last[:, None, :]
        y[:, :, 4] = np.clip(y[:, :, 4], *scales["jaw_range"])
        return y

    def last_command(self, held: np.ndarray, observation: Any = None) -> np.ndarray:
        """Tip and roll of the command in force, (4,); ``held`` itself where the arm begins anew.

        Args:
            held: The command in force by the observation, (4,); used if none was said, or what was
                said was refused or came too late to be obeyed.
            observation: Its grid time chooses the row of the last chunk: in real time a slow answer
                misses observations. Default: the first row.
        """
        if self._said is None:
            return held
        step, at = getattr(observation, "step", None), self._said_at
        row = 0 if step is None or at is None else min(max(step - at, 0), len(self._said) - 1)
        said: np.ndarray = self._said[row, :4]
        if row < self._late:
            return held.copy()
        return held if np.linalg.norm(said[:3] - held[:3]) > REACH else said

    def say(self, chunk: np.ndarray, observation: Any) -> np.ndarray:
        """Remember a chunk (K, 5) as what the arm is told, and return it."""
        step = getattr(observation, "step", None)
        self._said, self._said_at = chunk, None if step is None else step + 1
        return chunk

    def goes_on(self, observation: Any) -> bool:
        """Whether the last chunk goes on: `_kept` of its steps are played from where it was asked.

        Otherwise a new one is asked for now; a policy that keeps to it sets `_kept`. Call it once
        for each observation. Without a grid time they are counted.
        """
        step = getattr(observation, "step", None)
        now = self._count if step is None else int(step)
        self._count = now + 1
        if self._said is not None and 0 <= now - self._asked < self._kept:
            if step is None:
                self._said = self._said[1:]  # its first row is the command in force
            return True
        self._asked, self._kept = now, 0
        return False

    def acknowledged(self, head: Mapping[str, Any]) -> None:
        """The server says what became of earlier steps: after a refusal the arm is at rest.

        The first steps of an answer that takes long are late: others are executed in their place.
        """
        self._late = head.get("late", 0)
        if head["rejected"]:
            self._said = None

    def see(self, observation: Any) -> Mapping[str, np.ndarray]:
        """The arrays of an observation, after a check that their columns are those of the training.

        Args:
            observation: A `surg_policy_client.Observation`, or arrays by key.

        Raises:
            ValueError: The columns differ, or their order does.
        """
        spec = getattr(observation, "spec", None)
        if spec is not None and not self._checked:
            for key in self.wants:
                served = list(spec.observation[key].names or ())
                if key in self.names and served != self.names[key]:
                    raise ValueError(
                        f"{key} is served as {', '.join(served)[:200]}; this policy was trained on "
                        f"{', '.join(self.names[key])[:200]}"
                    )
            self._checked = True
        return getattr(observation, "arrays", observation)
