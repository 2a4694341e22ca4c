"""The gateway to ROS 2 of `--ros2`: its options, what they need, and its node."""

from __future__ import annotations

import argparse
import os
import socket

from surg_cli.graph import topic_contract
from surg_cli.host import provision
from surg_cli.host.terminal import CliError

LOOPBACK = "lo"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add = parser.add_argument
    add(
        "--ros2",
        nargs="?",
        const=LOOPBACK,
        metavar="INTERFACE",
        help="publish the topics for ROS 2 too, on a network interface (without a name: this "
        "machine alone); domain: ROS_DOMAIN_ID (docs/guide/coming_from_ros2.md)",
    )
    add(
        "--ros2-commands",
        action="store_true",
        help="with --ros2: obey ROS 2 nodes too. DDS asks nobody who he is",
    )


def parameters(options: argparse.Namespace) -> dict[str, object] | None:
    """The parameters of the gateway, with what it needs installed; None: it is not wanted.

    Raises:
        CliError: There is no such interface or domain, or a package cannot be had.
    """
    if options.ros2 is None:
        if options.ros2_commands:
            raise CliError("--ros2-commands: only with --ros2", 2)
        return None
    from surg_ros2.bridged_topics import IMPLEMENTATIONS, LARGEST_DOMAIN

    known = [name for _, name in socket.if_nameindex()]
    if options.ros2 not in known:
        raise CliError(
            f"--ros2 {options.ros2}: no such network interface; there are {', '.join(known)}", 2
        )
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not (domain.isascii() and domain.isdecimal() and int(domain) <= LARGEST_DOMAIN):
        allowed = f"expected a whole number from 0 to {LARGEST_DOMAIN}"
        raise CliError(f"ROS_DOMAIN_ID={domain}: {allowed}", 2)
    framing = os.environ.get("RMW_IMPLEMENTATION") or IMPLEMENTATIONS[0]
    if framing not in IMPLEMENTATIONS:
        allowed = " or ".join(IMPLEMENTATIONS)
        raise CliError(f"RMW_IMPLEMENTATION={framing}: expected {allowed}", 2)
    try:
        provision.need_dds()
    except CliError as problem:
        raise CliError(f"--ros2: {problem}", 2) from problem
    return {
        "contract": str(topic_contract.SOURCE),
        "interface": options.ros2,
        "commands": options.ros2_commands,
        "domain": int(domain),
        "implementation": framing,
    }
