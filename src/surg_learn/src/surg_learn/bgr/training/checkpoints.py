"""A training on its way, on disk: weights and optimiser, so that an interrupted one goes on.

The file is an .npz without pickle. What is drawn at a step depends on the seed and the step alone,
so that a training that goes on gives the weights of one that was not interrupted.
"""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from surg_learn.bgr.state_policy import write_weights

Array = np.ndarray
FORMAT = "surg_bgr_training/1"
MOMENTS = ("exp_avg", "exp_avg_sq")
"""What Adam remembers of each parameter, beside the number of steps."""
UNUSABLE = (
    OSError, KeyError, TypeError, ValueError, RuntimeError, EOFError, zipfile.BadZipFile,
)  # fmt: skip


def mark_of(options: Mapping[str, Any], arrays: Sequence[Array]) -> str:
    """SHA-256 of what a training depends on."""
    found = hashlib.sha256(json.dumps(options, sort_keys=True).encode())
    for array in arrays:
        found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()


class Kept:
    """The file of one training.

    Args:
        file: It is written at each `save`, whole or not at all.
        mark: See `mark_of`.
    """

    EVERY = 200
    """Steps between two files."""

    def __init__(self, file: Path, mark: str) -> None:
        self._file, self._mark = file, mark

    def save(self, step: int, network: Any, adam: Any) -> None:
        """Write the state before a step."""
        arrays = {f"net_{name}": value for name, value in network.state_dict().items()}
        for n, parameter in enumerate(network.parameters()):
            for moment in MOMENTS:
                arrays[f"{moment}_{n}"] = adam.state[parameter][moment]
        self._file.parent.mkdir(parents=True, exist_ok=True)
        head = {"format": FORMAT, "mark": self._mark, "step": step}
        write_weights(self._file, head, {n: v.cpu().numpy() for n, v in arrays.items()})

    def load(self, network: Any, adam: Any) -> int:
        """Set network and optimiser; returns the step to go on with, 0 without a file.

        Raises:
            ValueError: The file is of another training, or broken.
        """
        if not self._file.exists():
            return 0
        try:
            with np.load(self._file, allow_pickle=False) as found:
                arrays = {name: found[name] for name in found.files}
            head = json.loads(arrays.pop("head").tobytes())
            if (head["format"], head["mark"]) != (FORMAT, self._mark):
                raise ValueError("other data, options, PyTorch or number of threads")
            step = int(head["step"])
            there = {name: torch.from_numpy(array) for name, array in arrays.items()}
            network.load_state_dict({n: there[f"net_{n}"] for n in network.state_dict()})
            for n, parameter in enumerate(network.parameters()):
                adam.state[parameter] = {
                    "step": torch.tensor(float(step)),
                    **{m: there[f"{m}_{n}"].to(parameter.device) for m in MOMENTS},
                }
        except UNUSABLE as error:
            raise ValueError(
                f"{self._file}: not the beginning of this training ({error}); remove it to begin "
                "anew, or choose another --out"
            ) from None
        return step
