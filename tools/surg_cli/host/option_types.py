"""Types of command-line options, for argparse: numbers with a range. Help that several share."""

from __future__ import annotations

import argparse
import math

WHERE = "which episodes: 'success and setting == \"ex_vivo\"' (docs/guide/labelling.md)"
"""Help of the option that selects episodes."""


def positive(text: str) -> float:
    """A positive finite number."""
    return _number_between(text, math.ulp(0.0), 1e6, "a positive number")


def feedback_gain(text: str) -> float:
    """A lateral feedback gain [1/s]."""
    return _number_between(text, 0.0, 100.0, "0 to 100 (1/s)")


def tcp_port(text: str) -> int:
    """A TCP port that needs no root."""
    return int(_number_between(text, 1024, 65535, "a port from 1024 to 65535"))


def _number_between(text: str, low: float, high: float, allowed: str) -> float:
    """A finite number in a closed range.

    Raises:
        argparse.ArgumentTypeError: It is none; argparse ends the command with status 2.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: {allowed}")
    return value
