"""`./surg dev setup` and `./surg dev build`."""

from __future__ import annotations

import argparse

from surg_cli.host import paths, provision, workspace
from surg_cli.host.terminal import say


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options of the two commands."""
    if command == "setup":
        parser.add_argument(
            "--all", action="store_true", help="also the packages of test, export and bench"
        )
        parser.add_argument(
            "--gstreamer",
            action="store_true",
            help="also GStreamer, for endoscopes with the source gst:",
        )


def main(options: argparse.Namespace, command: str) -> int:
    """Set up the machine; build for `build`."""
    everything = command == "setup" and options.all
    if stages := provision.overview(everything):
        say(stages)
    optional = ("gstreamer",) if command == "setup" and options.gstreamer else ()
    done = provision.make_ready(everything, optional)
    if command == "build":
        done |= workspace.build(paths.STATE / "logs" / "build.log")
    if not done:
        say(f"{command}: nothing to do")
    return 0
