"""The gateway to ROS 2 of `--ros2`: its option, what it needs, and its node."""

from __future__ import annotations

import argparse
import os
import socket

from surg_cli.graph import topic_contract
from surg_cli.host import provision
from surg_cli.host.terminal import CliError

LOOPBACK = "lo"


def add_arguments(parser: argparse.ArgumentParser, commands: bool = True) -> None:
    """Declare the options; that for commands only where ROS 2 nodes may drive."""
    parser.add_argument(
        "--ros2",
        nargs="?",
        const=LOOPBACK,
        metavar="INTERFACE",
        help="publish the topics for ROS 2 too, on a network interface (without one: on this "
        "machine alone); domain: ROS_DOMAIN_ID (docs/guide/coming_from_ros2.md)",
    )
    if commands:
        parser.add_argument(
            "--ros2-commands",
            action="store_true",
            help="--ros2, and obey ROS 2 nodes: without DDS Security all that reach the interface",
        )


def asked(options: argparse.Namespace) -> str:
    """The option that asks for a gateway; empty: none does."""
    if getattr(options, "ros2_commands", False):
        return "--ros2-commands"
    return "" if options.ros2 is None else "--ros2"


def parameters(options: argparse.Namespace) -> dict[str, object] | None:
    """The parameters of the gateway, with what it needs installed; None: it is not wanted.

    Raises:
        CliError: There is no such interface or domain, or a package cannot be had.
    """
    if not asked(options):
        return None
    from surg_ros2 import enclave
    from surg_ros2.bridged_topics import IMPLEMENTATIONS, LARGEST_DOMAIN

    interface = options.ros2 or LOOPBACK
    known = [name for _, name in socket.if_nameindex()]
    if interface not in known:
        said = f"no such network interface; there are {', '.join(known)}"
        raise CliError(f"--ros2 {interface}: {said}", 2)
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not (domain.isascii() and domain.isdecimal() and int(domain) <= LARGEST_DOMAIN):
        allowed = f"expected a whole number from 0 to {LARGEST_DOMAIN}"
        raise CliError(f"ROS_DOMAIN_ID={domain}: {allowed}", 2)
    framing = os.environ.get("RMW_IMPLEMENTATION") or IMPLEMENTATIONS[0]
    if framing not in IMPLEMENTATIONS:
        allowed = " or ".join(IMPLEMENTATIONS)
        raise CliError(f"RMW_IMPLEMENTATION={framing}: expected {allowed}", 2)
    try:
        secured = enclave.folder(os.environ)
        provision.need_dds()
    except (CliError, ValueError) as problem:
        raise CliError(f"--ros2: {problem}", 2) from problem
    return {
        "contract": str(topic_contract.SOURCE),
        "interface": interface,
        "commands": getattr(options, "ros2_commands", False),
        "domain": int(domain),
        "implementation": framing,
        "enclave": "" if secured is None else str(secured),
    }
