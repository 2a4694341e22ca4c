"""`./surg policy keys`: key pairs for a model server and the policies that may connect to it."""

from __future__ import annotations

import argparse
from pathlib import Path

from surg_cli.host import paths
from surg_cli.host.terminal import CliError, say


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    add = parser.add_argument
    add(
        "--out",
        type=Path,
        default=paths.ROOT / "keys",
        metavar="DIR",
        help="folder (default: keys/ in the checkout, which git ignores)",
    )
    add(
        "name",
        nargs="?",
        default="policy",
        metavar="NAME",
        help="of the policy's machine or user (policy); each name has a key pair of its own",
    )


def main(options: argparse.Namespace, command: str) -> int:
    """Make the keys and print where each one belongs."""
    from surg_policy_client import BadKeys
    from surg_policy_client.keys import make

    try:
        made = make(options.out, options.name)
    except (BadKeys, OSError) as error:
        raise CliError(f"keys: {error}", 2) from None
    for path in made:
        say(f"  {path}")
    folder = options.out
    say(
        f"Server: ./surg run TASK --policy ADDRESS --policy-keys {folder}\n"
        f"Policy: copy {folder / options.name} to its machine (it holds a secret) and use "
        f"`--keys {options.name}` or serve(..., keys='{options.name}')"
    )
    return 0
