"""The policies that a benchmark compares, by their files of weights: each names its own kind."""

from __future__ import annotations

import json
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

SHIPPED = "shipped"
"""Method of the policy of `./surg learn bgr --cameras keypoints`."""


@dataclass(frozen=True)
class Entrant:
    """A policy that is judged.

    Attributes:
        weights: Its file.
        digest: SHA-256 of the weights.
        method: `SHIPPED`, or one of `cloned_networks.METHODS`.
        seed: Of its training; None: the file does not say.
        pictures: Observation keys of the pictures that it reads.
    """

    weights: Path
    digest: str
    method: str
    seed: int | None
    pictures: tuple[str, ...]

    @property
    def label(self) -> str:
        """For tables."""
        return self.method if self.seed is None else f"{self.method}, seed {self.seed}"


def policy_of(weights: Path) -> Any:
    """The policy of a file, on one thread.

    Raises:
        ValueError: The file holds no weights of a policy that looks, or of another action space.
    """
    from surg_learn.bgr.image_policy import ImagePolicy

    try:
        with np.load(weights, allow_pickle=False) as found:
            head = json.loads(found["head"].tobytes())
        said = head["format"]
    except (KeyError, ValueError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"{weights}: no weights of a policy ({error})") from None
    if not said.startswith("surg_cloned_policy/"):
        return ImagePolicy.load(weights)
    try:
        import torch
    except ImportError:
        raise ValueError(f"{weights}: PyTorch runs it: apt install python3-torch") from None
    from surg_learn.cloning.cloned_policy import ClonedPolicy

    torch.set_num_threads(1)
    return ClonedPolicy.load(weights)


def entrant(weights: Path) -> Entrant:
    """What a file of weights is.

    Raises:
        OSError: It cannot be read.
        ValueError: See `policy_of`.
    """
    policy = policy_of(weights)
    seed = policy.about.get("options", {}).get("seed")
    method = getattr(policy, "method", SHIPPED)
    return Entrant(weights, policy.hash, method, seed, pictures_of(policy))


def pictures_of(policy: Any) -> tuple[str, ...]:
    """Observation keys of the pictures that a policy reads."""
    return tuple(key for key in policy.wants if key.startswith("observation.images."))
