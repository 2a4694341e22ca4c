"""Types of command-line options, for argparse: numbers with a range. Help that several share."""

from __future__ import annotations

import argparse
import math

WHERE = "which episodes: 'success and setting == \"ex_vivo\"' (docs/guide/labelling.md)"
"""Help of the option that selects episodes."""


def add_video_quality(parser: argparse.ArgumentParser) -> None:
    """Options of the quality of recorded videos; ``video_quality`` reads them."""
    chosen = parser.add_mutually_exclusive_group()
    chosen.add_argument(
        "--video-crf", type=crf, metavar="Q", help="quality of recorded video, 0 best to 51 (23)"
    )
    chosen.add_argument(
        "--video-lossless", action="store_true", help="keep every pixel of a recorded video"
    )


def video_quality(options: argparse.Namespace) -> dict[str, object]:
    """The recorder's parameters of these options."""
    chosen: dict[str, object] = (
        {} if options.video_crf is None else {"video_crf": options.video_crf}
    )
    return {**chosen, **({"video_lossless": True} if options.video_lossless else {})}


def crf(text: str) -> int:
    """A constant quality of x264."""
    value = _number_between(text, 0, 51, "a whole number from 0 (best) to 51")
    if value != int(value):
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: a whole number from 0 (best) to 51")
    return int(value)


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
