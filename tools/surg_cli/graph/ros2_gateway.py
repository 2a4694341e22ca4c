"""The gateway to ROS 2 of `--ros2`: its option, what it needs, and its node."""

from __future__ import annotations

import argparse
import os
import socket
from collections.abc import Sequence

from surg_cli.graph import topic_contract
from surg_cli.host import provision
from surg_cli.host.terminal import CliError

LOOPBACK = "lo"
COMMANDS = "commands"
"""The word that lets ROS 2 nodes command."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the option."""
    parser.add_argument(
        "--ros2",
        nargs="*",
        metavar="WORD",
        help="publish the topics for ROS 2 too; WORD: a network interface (without one: this "
        f"machine alone), {COMMANDS} (obey ROS 2 nodes too; DDS asks nobody who he is); domain: "
        "ROS_DOMAIN_ID (docs/guide/coming_from_ros2.md)",
    )


def parameters(words: Sequence[str] | None) -> dict[str, object] | None:
    """The parameters of the gateway, with what it needs installed; None: it is not wanted.

    Args:
        words: Of the option; None without it.

    Raises:
        CliError: There is no such interface or domain, or a package cannot be had.
    """
    if words is None:
        return None
    from surg_ros2.bridged_topics import IMPLEMENTATIONS, LARGEST_DOMAIN

    interface, *more = [word for word in words if word != COMMANDS] or [LOOPBACK]
    known = [name for _, name in socket.if_nameindex()]
    if more or interface not in known:
        said = "one network interface at most" if more else "no such network interface"
        allowed = f"there are {', '.join(known)}, and the word {COMMANDS}"
        raise CliError(f"--ros2 {' '.join(words)}: {said}; {allowed}", 2)
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not (domain.isascii() and domain.isdecimal() and int(domain) <= LARGEST_DOMAIN):
        allowed = f"expected a whole number from 0 to {LARGEST_DOMAIN}"
        raise CliError(f"ROS_DOMAIN_ID={domain}: {allowed}", 2)
    framing = os.environ.get("RMW_IMPLEMENTATION") or IMPLEMENTATIONS[0]
    if framing not in IMPLEMENTATIONS:
        allowed = " or ".join(IMPLEMENTATIONS)
        raise CliError(f"RMW_IMPLEMENTATION={framing}: expected {allowed}", 2)
    if os.environ.get("ROS_SECURITY_ENABLE", "").lower() == "true":
        raise CliError(
            "ROS_SECURITY_ENABLE=true: the gateway's DDS has no security plugins, so it would hear "
            "nobody; unset it here and for the ROS 2 nodes, on a network of your own",
            2,
        )
    try:
        provision.need_dds()
    except CliError as problem:
        raise CliError(f"--ros2: {problem}", 2) from problem
    return {
        "contract": str(topic_contract.SOURCE),
        "interface": interface,
        "commands": COMMANDS in words,
        "domain": int(domain),
        "implementation": framing,
    }
