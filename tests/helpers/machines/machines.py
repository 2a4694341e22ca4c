"""Two machines on one cable: network namespaces, and a relay in user space between them."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

RELAY = Path(__file__).with_name("wire_relay.py")


def ip(*words: str) -> str:
    """Run `ip WORDS`.

    Raises:
        PermissionError: It is not allowed here, or there is no `ip`.
    """
    try:
        done = subprocess.run(["ip", *words], capture_output=True, text=True, check=False)
    except FileNotFoundError as error:
        raise PermissionError("there is no `ip` (iproute2)") from error
    if done.returncode:
        raise PermissionError(f"ip {' '.join(words)}: {done.stderr.strip()}")
    return done.stdout


@dataclass
class Machines:
    """Two namespaces and the cable between them.

    Attributes:
        names: Namespace by machine.
        addresses: IPv4 address by machine.
    """

    names: dict[str, str]
    addresses: dict[str, str]
    relay: subprocess.Popen[str] = field(repr=False)

    def on(self, machine: str, *words: str) -> list[str]:
        """The command line that runs a program on a machine."""
        return ["ip", "netns", "exec", self.names[machine], *words]

    def cable(self, command: str) -> None:
        """Tell the relay something; see ``wire_relay``."""
        assert self.relay.stdin is not None and self.relay.stdout is not None
        self.relay.stdin.write(command + "\n")
        self.relay.stdin.flush()
        answer = self.relay.stdout.readline()
        assert answer == "ok\n", f"the relay has ended: {answer!r}"


@contextlib.contextmanager
def two_machines(seed: int = 1) -> Iterator[Machines]:
    """Namespaces ``robot`` and ``operator``; nothing of them reaches any other network.

    Args:
        seed: Of what the cable does at random.

    Raises:
        PermissionError: Namespaces are not permitted here.
    """
    pid = os.getpid()
    names = {name: f"surg{pid}{name[0]}" for name in ("robot", "operator", "cable")}
    addresses = {"robot": "10.77.0.1", "operator": "10.77.0.2"}
    made: list[str] = []
    relay = None
    try:
        for name in names.values():
            ip("netns", "add", name)
            made.append(name)
            ip("-n", name, "link", "set", "lo", "up")
        for machine, address in addresses.items():
            inner, outer = f"s{pid}{machine[0]}", f"c{pid}{machine[0]}"
            ip("-n", names["cable"], "link", "add", outer, "type", "veth", "peer", "name", inner)
            ip("-n", names["cable"], "link", "set", inner, "netns", names[machine])
            ip("-n", names[machine], "addr", "add", f"{address}/24", "dev", inner)
            ip("-n", names[machine], "link", "set", inner, "up")
            ip("-n", names["cable"], "link", "set", outer, "up")
        relay = subprocess.Popen(
            [
                *("ip", "netns", "exec", names["cable"], sys.executable, "-s", str(RELAY)),
                *(f"c{pid}r", f"c{pid}o", str(seed)),
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert relay.stdout is not None
        if relay.stdout.readline() != "ok\n":
            raise PermissionError("the relay may not open packet sockets here")
        yield Machines(names, addresses, relay)
    finally:
        if relay is not None:
            assert relay.stdin is not None
            relay.stdin.close()
            relay.wait(10)
        for name in made:
            with contextlib.suppress(PermissionError):
                ip("netns", "del", name)
