"""`./surg episode depth EPISODE`: depth of a recorded stereo endoscope, computed afterwards."""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from typing import Any

from surg_cli.host import option_types
from surg_cli.host.terminal import CliError, Progress, say, warn


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    option_types.add_episode(parser)
    add = parser.add_argument
    add("--out", type=Path, metavar="DIR", help="default: <EPISODE>_depth beside the episode")
    add(
        "--method",
        default="sgbm_8",
        metavar="M",
        help="sgbm_8 (default), sgbm, or the path of a .py file",
    )
    add("--size", type=_size, metavar="WxH", help="of the rectified pictures (as recorded)")
    add(
        "--range",
        nargs=2,
        type=option_types.positive,
        default=(0.04, 0.30),
        metavar=("NEAR", "FAR"),
        help="nearest and farthest depth in metres (0.04 0.30)",
    )


def main(options: argparse.Namespace, command: str) -> int:
    """Compute, write, and print the figures; the last line is the folder."""
    from surg_core import ConfigError
    from surg_perception.depth.episode_depth import DepthOptions, compute
    from surg_perception.depth.recorded_eyes import GOOD_CRF, RecordedEyes
    from surg_perception.depth.stereo_matcher import MatcherError
    from surg_recording.episode import episode_reader
    from surg_recording.recording_errors import EpisodeError

    folder = options.episode.absolute()
    out = options.out or folder.with_name(f"{folder.name}_depth")
    near, far = options.range
    chosen = DepthOptions(options.method, options.size, near, far)
    try:
        eyes = RecordedEyes(episode_reader.read(folder))
        if eyes.coarse:
            warn(
                f"depth: the videos were recorded with crf {eyes.quality}, which costs depth; "
                f"record with --video-crf {GOOD_CRF} or lossless"
            )
        with Progress("depth") as progress:
            figures = compute(eyes, out, chosen, progress.update)
    except (EpisodeError, ConfigError, MatcherError, ValueError) as problem:
        raise CliError(f"depth: {problem}", 2) from problem
    for line in _lines(figures):
        say(line)
    say(str(out))
    return 0


def _lines(figures: dict[str, Any]) -> list[str]:
    width, height = figures["size"]
    seen = "nothing has a depth"
    if figures["median_depth_m"] is not None:
        low, high = (1e3 * each for each in figures["median_depth_m"])
        seen = f"their medians lie at {low:.0f} to {high:.0f} mm"
    lost = f"; {figures['unpaired']} pictures without a partner" if figures["unpaired"] else ""
    return [
        f"{figures['pairs']} pairs of {width} x {height}, {1e3 * figures['seconds_per_pair']:.0f} "
        f"ms each{lost}",
        f"{100 * figures['known']:.0f} % of the pixels have a depth; {seen}",
        f"f {figures['f'][0]:.1f} px, baseline {1e3 * figures['baseline_m']:.3f} mm: a quarter of "
        f"a pixel is {1e3 * 0.25 * 0.08**2 / (figures['f'][0] * figures['baseline_m']):.1f} mm at "
        "80 mm",
    ]


def _size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{2,5})x(\d{2,5})", text)
    if match is None or not 16 <= int(match[1]) <= 7680 or not 16 <= int(match[2]) <= 4320:
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: such as 640x480, 16x16 to 7680x4320")
    return int(match[1]), int(match[2])
