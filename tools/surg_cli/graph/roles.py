"""What a machine is in a cell that is spread over several, and what follows for its nodes.

Pure: a cell, a role and what the kernel says of the network go in; an environment, or the reason
why there is none, comes out. ROS 1 knows no passwords: whoever reaches its ports drives the robot.
So a role is refused unless its address is in the cell, the cell calls the network isolated, and
this machine does not also use that network to reach others.
"""

from __future__ import annotations

import enum
import ipaddress
import re
import socket
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from surg_cli.host.terminal import CliError


class Role(enum.StrEnum):
    """What a machine of the cell does."""

    ROBOT = "robot"
    """ROS master, robot links (or the simulator), controllers, recorder."""
    OPERATOR = "operator"
    """Leaders and teleoperation."""
    ENDOSCOPE = "endoscope"
    """Cameras."""


@dataclass(frozen=True)
class Timeouts:
    """The time-outs of a role."""

    master: float  # for the ROS master of the robot's machine to answer at the start [s]
    gone: float  # from which silence of that master on a role gives up and ends its nodes [s]
    # after which what the other side has not acknowledged is thrown away with its connection [s]: a
    # link that comes back later delivers nothing old
    tcp: float


WAITS = {
    # The watchdogs that stop an arm (F03, F10, F25) are the controller's and the same everywhere:
    # no network is a reason to wait longer for a command.
    Role.ROBOT: Timeouts(master=15.0, gone=5.0, tcp=3.0),
    # A person starts the machines one after the other.
    Role.OPERATOR: Timeouts(master=120.0, gone=3.0, tcp=3.0),
    # Pictures are worth waiting for a little longer: nothing moves by them.
    Role.ENDOSCOPE: Timeouts(master=120.0, gone=10.0, tcp=5.0),
}


@dataclass(frozen=True)
class Route:
    """One line of the kernel's table of routes; gateway 0.0.0.0: none."""

    interface: str
    network: ipaddress.IPv4Network
    gateway: ipaddress.IPv4Address


def routes(text: str) -> list[Route]:
    """The lines of /proc/net/route."""
    table = []
    for line in text.splitlines()[1:]:
        interface, *fields = line.split()
        address, gateway, mask = (_address(fields[i]) for i in (0, 1, 6))
        table.append(Route(interface, ipaddress.IPv4Network(f"{address}/{mask}"), gateway))
    return table


def local_addresses(text: str) -> set[str]:
    """IPv4 addresses of this machine from /proc/net/fib_trie, second ones of an interface too."""
    addresses, address = set(), ""
    for line in text.splitlines():
        if match := re.match(r"\s*\|-- (\S+)", line):
            address = match[1]
        elif re.match(r"\s*/32 host LOCAL", line) and not address.startswith("127."):
            addresses.add(address)
    return addresses


def _address(word: str) -> ipaddress.IPv4Address:
    """/proc writes addresses as the processor holds them."""
    return ipaddress.IPv4Address(struct.pack("=I", int(word, 16)))


def link_of(config: Any, role: Role, port: int) -> Link:
    """A role's place in a ``surg_core`` CellConfig.

    Raises:
        CliError: The cell does not name this machine, or does not call its network isolated.
    """
    if config.network != "isolated" or not config.machines:
        raise CliError(
            f"--role {role}: {config.file} has 'network: {config.network}'"
            f"{'' if config.machines else ' and no machines'}. ROS 1 ports are opened for another "
            "machine only on a network that the cell calls isolated: a switch and cables of its "
            "own, without a router. Then write into cell.yaml:\n"
            "network: isolated\nmachines:\n  robot: 192.168.77.1\n  operator: 192.168.77.2",
            2,
        )
    if role not in config.machines:
        raise CliError(
            f"--role {role}: {config.file}: machines.{role} is missing; it names "
            f"{', '.join(config.machines)}. Add this machine's address on the isolated network",
            2,
        )
    machines = {Role(name): str(address) for name, address in config.machines.items()}
    others = tuple(name.value for name in machines if name is not role)
    return Link(role, machines[role], machines[Role.ROBOT], port, others)


def check_address(
    address: str, role: Role, has: bool, interfaces: Mapping[str, str], table: Sequence[Route]
) -> None:
    """Refuse a role's address that is not this machine's, or that leads elsewhere.

    ``interfaces`` holds the first address of each interface by name, ``table`` the routes.

    Raises:
        CliError: With the cure.
    """
    if not has:
        known = ", ".join(f"{first} ({name})" for name, first in interfaces.items())
        raise CliError(
            f"--role {role}: this machine does not have machines.{role} = {address}; it has "
            f"{known or 'no address'}. Start the role on its own machine, or "
            "correct cell.yaml, or plug the cable in and give the interface that address",
            2,
        )
    own = ipaddress.IPv4Address(address)
    # Both ways: a second address is in no list, and one with the mask /32 in no route.
    ours = {r.interface for r in table if r.network.prefixlen and own in r.network}
    ours |= {name for name, first in interfaces.items() if first == address}
    if not ours:
        raise CliError(
            f"--role {role}: no interface of this machine is known to have {address}, so nobody "
            "can tell where it leads. Give the robot's interface that address with the mask of "
            f"its network (ip addr add {address}/24 dev INTERFACE)",
            2,
        )
    for route in table:
        if route.interface in ours and int(route.gateway):
            raise CliError(
                f"--role {role}: {address} is routable: its interface {route.interface} also leads "
                f"to other networks through the router {route.gateway}. An isolated network has "
                "none. Put the robot's cable into an interface of its own, or remove that route "
                f"(ip route del default via {route.gateway} dev {route.interface})",
                2,
            )


@dataclass(frozen=True)
class Link:
    """One machine's place in the cell."""

    role: Role
    address: str  # its address on the isolated network
    robot: str  # the robot machine's, where the ROS master is
    port: int  # of the ROS master
    others: tuple[str, ...] = ()  # roles of the other machines of the cell
    guard: bool = False  # whether the nodes get the port guard (--port-guard)

    @property
    def uri(self) -> str:
        """ROS_MASTER_URI."""
        return f"http://{self.robot}:{self.port}"

    @property
    def timeouts(self) -> Timeouts:
        """The role's time-outs."""
        return WAITS[self.role]

    def environment(self, base: Mapping[str, str], guard: Path) -> dict[str, str]:
        """The environment of the machine's nodes; ``guard`` binds every port to ``address``."""
        env = {name: value for name, value in base.items() if name != "ROS_HOSTNAME"}
        env.update(ROS_IP=self.address, ROS_MASTER_URI=self.uri)
        if not self.guard:
            return env
        preload = [part for part in env.get("LD_PRELOAD", "").split(":") if part]
        env.update(
            LD_PRELOAD=":".join([str(guard), *(p for p in preload if p != str(guard))]),
            SURG_LISTEN_ON=self.address,
            SURG_TCP_TIMEOUT_MS=str(round(1000 * self.timeouts.tcp)),
        )
        return env


def foreign_ports(sockets: Mapping[int, str], held: Mapping[str, set[int]], own: str) -> list[str]:
    """TCP ports that are open on other addresses than ``own`` and the loopback, one text each.

    ``sockets``: listening, inode -> "address:port". ``held``: node name -> inodes of its sockets.
    """
    allowed = (own, "127.0.0.1", "::1")
    return [
        f"{name} listens on {sockets[inode]}"
        for name, inodes in sorted(held.items())
        for inode in sorted(inodes & sockets.keys())
        if sockets[inode].rpartition(":")[0] not in allowed
    ]


def listening(text: str, text6: str = "") -> dict[int, str]:
    """Listening TCP sockets, inode -> "address:port", of /proc/net/tcp and /proc/net/tcp6."""
    sockets = {}
    for lines, family in ((text, socket.AF_INET), (text6, socket.AF_INET6)):
        for line in lines.splitlines()[1:]:
            fields = line.split()
            if len(fields) < 10 or fields[3] != "0A":
                continue
            address, _, port = fields[1].partition(":")
            words = [int(address[i : i + 8], 16) for i in range(0, len(address), 8)]
            packed = struct.pack(f"={len(words)}I", *words)
            sockets[int(fields[9])] = f"{socket.inet_ntop(family, packed)}:{int(port, 16)}"
    return sockets
