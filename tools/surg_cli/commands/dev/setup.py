"""`./surg dev setup` and `./surg dev build`."""

from __future__ import annotations

import argparse

from surg_cli.host import paths, provision, workspace
from surg_cli.host.terminal import say


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options of the two commands."""
    parser.add_argument(
        "--all", action="store_true", help="also the packages of test, export and bench"
    )
    if command == "setup":
        parser.add_argument(
            "--gstreamer",
            action="store_true",
            help="also GStreamer, for endoscopes with the source gst: or decklink:",
        )
    if command == "build":
        parser.add_argument("--force", action="store_true", help="build even if nothing changed")


def main(options: argparse.Namespace, command: str) -> int:
    """Set up the machine; build for `build`."""
    if stages := provision.overview(options.all):
        say(stages)
    optional = ("gstreamer",) if command == "setup" and options.gstreamer else ()
    done = provision.make_ready(options.all, optional)
    if command == "build":
        done |= workspace.build(paths.STATE / "logs" / "build.log", options.force)
    if not done:
        say(f"{command}: nothing to do")
    return 0
