"""Where PyTorch trains; `python3 -m surg_learn.cloning.training.torch_device cuda` asks."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

DEVICES = ("auto", "cpu", "cuda")


def pytorch() -> Any:
    """The module.

    Raises:
        ValueError: It is not installed.
    """
    try:
        import torch
    except ImportError:
        raise ValueError("PyTorch trains the network: apt install python3-torch") from None
    return torch


def device_for(wanted: str) -> str:
    """Where PyTorch trains: ``cpu`` or ``cuda``.

    Args:
        wanted: One of `DEVICES`; ``auto``: a GPU where PyTorch finds one.

    Raises:
        ValueError: It is none of them, PyTorch finds no GPU, or PyTorch is not installed.
    """
    if wanted not in DEVICES:
        raise ValueError(f"--device {wanted}: allowed are {', '.join(DEVICES)}")
    if wanted == "cpu":
        return "cpu"
    torch = pytorch()
    if torch.cuda.is_available():
        return "cuda"
    if wanted == "auto":
        return "cpu"
    built = torch.version.cuda
    why = "finds no GPU" if built else "was built without CUDA"
    raise ValueError(
        f"--device {wanted}: PyTorch {torch.__version__} {why}; --device cpu trains on the "
        "processor, --device auto on a GPU where there is one"
    )


def main(words: Sequence[str]) -> int:
    """Say where `--device WORD` trains; returns 0, or 2 where it cannot."""
    try:
        print(device_for(*words))
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
