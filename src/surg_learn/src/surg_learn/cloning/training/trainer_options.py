"""The command line that all trainers have: a dataset in, progress, a file of weights out."""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

from surg_learn.cloning.chunk_policy import ChunkPolicy
from surg_learn.cloning.training.lerobot_dataset import Progress

Options = TypeVar("Options")


def parser_of(name: str, about: str) -> argparse.ArgumentParser:
    """Arguments of all trainers; an option that is not given is missing, see `chosen`.

    Args:
        name: Of the program.
        about: One line.
    """
    parser = argparse.ArgumentParser(prog=name, description=about)
    parser.add_argument("dataset", type=Path, help="folder written by ./surg episode export")
    parser.add_argument("--out", type=Path, required=True, help="file for the weights (.npz)")
    parser.add_argument("--json", action="store_true", help="progress as JSON lines")
    for option, what in (
        ("seed", "seed of the training (default 0)"),
        ("steps", "optimiser steps"),
        ("chunk", "actions predicted at once"),
    ):
        parser.add_argument(f"--{option}", type=int, default=argparse.SUPPRESS, help=what)
    return parser


def chosen(kind: Callable[..., Options], given: argparse.Namespace, **more: Any) -> Options:
    """A dataclass of options from those that are given.

    Args:
        kind: The dataclass.
        given: The command line.
        **more: Further options.
    """
    names = {each.name for each in fields(kind)}  # type: ignore[arg-type]
    return kind(**{n: v for n, v in vars(given).items() if n in names}, **more)


def trained(
    name: str,
    given: argparse.Namespace,
    make: Callable[[Progress], ChunkPolicy],
    brief: Callable[[dict[str, Any]], str],
) -> int:
    """Train, save, and say how it went.

    Args:
        name: Of the program.
        given: The command line.
        make: Trains.
        brief: A line about a policy, from what it knows of itself.

    Returns:
        Exit status: 0 done, 2 for an unusable dataset, 130 if interrupted.
    """
    started = time.monotonic()

    def show(part: float, note: str) -> None:
        print(json.dumps({"part": part, "note": note}) if given.json else note, flush=True)

    try:
        policy = make(show)
    except ValueError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"{name}: interrupted", file=sys.stderr)
        return 130
    given.out.parent.mkdir(parents=True, exist_ok=True)
    policy.save(given.out)
    words = brief({"chunk": policy.chunk, **policy.about})
    spent = {"weights": policy.hash, "s": time.monotonic() - started}
    told = json.dumps({**policy.about, "words": words, **spent})
    print(told if given.json else f"{words}; weights {policy.hash[:16]}", flush=True)
    return 0


def brief_of(known: dict[str, Any]) -> str:
    """Of the policies with a hand."""
    losses = ", ".join(f"{split} {value:.4f}" for split, value in known["loss"].items())
    return (
        f"chunks of {known['chunk']}, {known.get('network', 'multilayer perceptron')}, "
        f"{known['parameters']} parameters, {known['frames']} frames, loss {losses}"
    )


def half_cosine(part: float) -> float:
    """Factor of the learning rate after a share of the training: from 1 to 0."""
    return 0.5 * (1 + math.cos(math.pi * part))
