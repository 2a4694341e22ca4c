"""Types of command-line options, for argparse: numbers with a range. Help that several share."""

from __future__ import annotations

import argparse
import math
import re
from pathlib import Path

WHERE = "which episodes: 'success and setting == \"ex_vivo\"' (docs/guide/labelling.md)"
"""Help of the option that selects episodes."""
LOSSLESS = "lossless"


def add_episode(parser: argparse.ArgumentParser) -> None:
    """The argument that names a recorded episode, or the run that holds one."""
    what = "an episode's folder, or that of a run with one episode"
    parser.add_argument("episode", type=_episode, metavar="EPISODE", help=what)


def _episode(text: str) -> Path:
    """An episode's folder: the one given, or the only one below it."""
    from surg_recording.episode import episode_reader

    given = Path(text)
    found = episode_reader.below(given) if given.is_dir() else []
    if not found:
        return given
    if len(found) > 1:
        names = "\n".join(f"  {folder}" for folder in found)
        raise argparse.ArgumentTypeError(f"{text} has {len(found)} episodes; name one:\n{names}")
    return found[0]


def add_video_quality(parser: argparse.ArgumentParser) -> None:
    """The option of the quality of recorded videos; ``video_quality`` reads it."""
    parser.add_argument(
        "--video-crf",
        type=crf,
        metavar="Q",
        help="quality of recorded video: 0 best to 51 (23), or lossless: every pixel is kept",
    )


def video_quality(options: argparse.Namespace) -> dict[str, object]:
    """The recorder's parameters of this option."""
    quality = options.video_crf
    if quality is None:
        return {}
    return {"video_lossless": True} if quality == LOSSLESS else {"video_crf": quality}


def crf(text: str) -> int | str:
    """A constant quality of x264, or `lossless`."""
    if text == LOSSLESS:
        return text
    allowed = f"a whole number from 0 (best) to 51, or {LOSSLESS}"
    value = _number_between(text, 0, 51, allowed)
    if value != int(value):
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: {allowed}")
    return int(value)


def positive(text: str) -> float:
    """A positive finite number."""
    return _number_between(text, math.ulp(0.0), 1e6, "a positive number")


def tcp_port(text: str) -> int:
    """A TCP port that needs no root."""
    return int(_number_between(text, 1024, 65535, "a port from 1024 to 65535"))


def address_and_port(text: str) -> tuple[str, int | None]:
    """An address to listen on, and a port if one is given: `127.0.0.1:8090`, `[::1]`."""
    match = re.fullmatch(r"(\[[^]]*\]|[^:]*)(?::(\d+))?", text)
    if match is None or not match[1]:
        raise argparse.ArgumentTypeError(
            f"{text!r}; allowed: an address, or such as 127.0.0.1:8090 or [::1]:8090"
        )
    return match[1].strip("[]"), None if match[2] is None else tcp_port(match[2])


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
