"""The stages of `./surg learn` before the roll-outs, on a machine without ROS such as a cluster's.

    PYTHONPATH=tools python3 -m surg_cli.without_ros bgr --cameras --out runs/L

Options are those of `./surg learn`, and the folder is its folder: copied to a machine with ROS,
`./surg learn` goes on there with the roll-outs. docs/guide/learning/without_ros.md
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from surg_cli.commands import learn
from surg_cli.graph import episode_plans
from surg_cli.host import terminal
from surg_cli.host.terminal import CliError, say, warn
from surg_learn import learn_stages
from surg_learn.learn_terminal import LearnError
from surg_learn.recipes import Request
from surg_learn.stage_ledger import Ledger

PROGRAM = "PYTHONPATH=tools python3 -m surg_cli.without_ros"


def options_of(words: Sequence[str]) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog=PROGRAM, description=(__doc__ or "").split("\n")[0])
    learn.add_arguments(parser, "learn")
    parser.epilog = "--rollouts is for the roll-outs that ./surg learn plays later in this folder."
    both = "record both views of the endoscope; the bundled policy is trained with the left one"
    parser.add_argument("--both-views", action="store_true", help=both)
    return parser.parse_args(words)


def prepare(options: argparse.Namespace) -> tuple[Request, Path]:
    """Do the stages; returns the request and the folder of the run."""
    request = learn.check(options)
    if options.both_views and not request.cameras:
        raise CliError("--both-views: without --cameras no picture is recorded", 2)
    learn_stages.check_device(request)
    out = learn.folder_of(options.out, request)
    resume = f"{PROGRAM} {learn.command_line(request, out).removeprefix('./surg learn ')}"
    resume += " --both-views" if options.both_views else ""
    ledger = Ledger(out / "stages.json", resume, say)
    more_views = episode_plans.VIEWS["stereo"] if options.both_views else ()
    cell = episode_plans.find_cell(request.robot)
    done = learn_stages.prepare(request, ledger, cell, out, terminal, more_views)
    say(f"demonstrations: {done['demonstrations']['success']} of {request.episodes} succeeded")
    say(f"policy: {done['training']['words']}")
    say("stages [s]: " + ", ".join(f"{name} {s:.0f}" for name, s in ledger.seconds.items()))
    return request, out


def main(words: Sequence[str]) -> int:
    """Entry point; the last line printed is the path of the weights."""
    try:
        request, out = prepare(options_of(words))
    except (CliError, LearnError) as problem:
        warn(f"without_ros: {problem}")
        return problem.code
    there = replace(request, device="auto")  # what is trained is trained
    say(f"On a machine with ROS the roll-outs follow by: {learn.command_line(there, out)}")
    say(str(out / "weights.npz"))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
