"""What the kernel says of this machine's network; `roles` decides what follows."""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import socket
import struct
from collections.abc import Iterable
from pathlib import Path

from surg_cli.graph import processes, roles
from surg_cli.host import paths
from surg_cli.host.terminal import CliError

GUARD = paths.DEVEL / "lib" / "libsurg_net_guard.so"
_SIOCGIFADDR = 0x8915


def check(address: str, role: roles.Role, guard: bool) -> None:
    """Refuse an address on which this machine may not open ROS ports.

    Raises:
        CliError: With the cure.
    """
    table = roles.routes(Path("/proc/net/route").read_text("utf-8"))
    roles.check_address(address, role, has(address), addresses(), table)
    if not guard:
        refuse_other_addresses(address)
    elif not GUARD.is_file():
        raise CliError(f"{GUARD} is missing; run ./surg dev build")


def has(address: str) -> bool:
    """Whether this machine has an IPv4 address."""
    with socket.socket() as probe:
        try:
            probe.bind((address, 0))
        except OSError:
            return False
    return True


def addresses() -> dict[str, str]:
    """First IPv4 address of every interface but the loopback, by the interface's name."""
    first = {}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        for _, name in socket.if_nameindex():
            with contextlib.suppress(OSError):
                request = struct.pack("256s", name.encode()[:15])
                answer = fcntl.ioctl(probe.fileno(), _SIOCGIFADDR, request)
                first[name] = socket.inet_ntoa(answer[20:24])
    return {name: text for name, text in first.items() if not text.startswith("127.")}


def other_addresses(own: str) -> set[str]:
    """IPv4 addresses of this machine beside ``own`` and the loopback, whatever the interface."""
    return roles.local_addresses(Path("/proc/net/fib_trie").read_text("utf-8")) - {own}


def refuse_other_addresses(own: str) -> None:
    """Refuse a machine with an address on another network, where ROS 1 would open its ports too."""
    others = other_addresses(own)
    if others:
        raise CliError(
            f"this machine also has {', '.join(sorted(others))}, and ROS 1 opens its ports on "
            "every address. Add --port-guard, which preloads a library that binds them to "
            f"{own}, or disconnect the other network",
            2,
        )


def refuse_foreign_ports(children: Iterable[processes.Child], link: roles.Link) -> None:
    """Check that no port of this process and the nodes can be reached from another network.

    Raises:
        CliError: Without the guard: the machine has an address on another network. With it: a port
            is open on another address.
    """
    own = link.address
    if not link.guard:
        refuse_other_addresses(own)
        return
    held = {"surg": _inodes(os.getpid())}
    for child in children:
        members = processes.session_members(child.process.pid)
        held[child.name] = set().union(*map(_inodes, members))
    tables = [Path(f"/proc/net/{name}").read_text("utf-8") for name in ("tcp", "tcp6")]
    wrong = roles.foreign_ports(roles.listening(*tables), held, own)
    if wrong:
        raise CliError(
            f"ROS ports are open beyond {own}: {'; '.join(wrong)}. Everything is stopped: a "
            "program that does not take LD_PRELOAD must not run here"
        )


def _inodes(pid: int) -> set[int]:
    """Inodes of the sockets of a process."""
    inodes = set()
    with contextlib.suppress(OSError):
        for entry in os.scandir(f"/proc/{pid}/fd"):
            with contextlib.suppress(OSError):
                match = re.fullmatch(r"socket:\[(\d+)\]", os.readlink(entry.path))
                if match:
                    inodes.add(int(match[1]))
    return inodes
