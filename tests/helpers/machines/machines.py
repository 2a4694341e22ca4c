"""Machines on one cable, or on a switch: network namespaces, joined by a relay or a bridge."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
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
    """Namespaces and what lies between them.

    Attributes:
        names: Namespace by machine.
        addresses: IPv4 address by machine.
        interfaces: Of the wire's end, by machine.
    """

    names: dict[str, str]
    addresses: dict[str, str]
    interfaces: dict[str, str]
    relay: subprocess.Popen[str] | None = field(default=None, repr=False)

    def on(self, machine: str, *words: str) -> list[str]:
        """The command line that runs a program on a machine."""
        return ["ip", "netns", "exec", self.names[machine], *words]

    def cable(self, command: str) -> None:
        """Tell the relay something; see ``wire_relay``."""
        assert self.relay is not None
        assert self.relay.stdin is not None and self.relay.stdout is not None
        self.relay.stdin.write(command + "\n")
        self.relay.stdin.flush()
        answer = self.relay.stdout.readline()
        assert answer == "ok\n", f"the relay has ended: {answer!r}"


@contextlib.contextmanager
def _wired(machines: Sequence[str]) -> Iterator[tuple[Machines, str, list[str]]]:
    """Namespaces of machines, that of what lies between them, and the ends of their wires there.

    Nothing of them reaches any other network.
    """
    pid, between = os.getpid(), f"surg{os.getpid()}c"
    found = Machines(
        {machine: f"surg{pid}{machine[0]}" for machine in machines},
        {machine: f"10.77.0.{k + 1}" for k, machine in enumerate(machines)},
        {machine: f"s{pid}{machine[0]}" for machine in machines},
    )
    made: list[str] = []
    try:
        for name in (between, *found.names.values()):
            ip("netns", "add", name)
            made.append(name)
            ip("-n", name, "link", "set", "lo", "up")
        ends = []
        for machine, inner in found.interfaces.items():
            ends.append(outer := f"c{pid}{machine[0]}")
            name, address = found.names[machine], found.addresses[machine]
            ip("-n", between, "link", "add", outer, "type", "veth", "peer", "name", inner)
            ip("-n", between, "link", "set", inner, "netns", name)
            ip("-n", name, "addr", "add", f"{address}/24", "dev", inner)
            ip("-n", name, "link", "set", inner, "up")
            ip("-n", between, "link", "set", outer, "up")
        yield found, between, ends
    finally:
        for name in made:
            with contextlib.suppress(PermissionError):
                ip("netns", "del", name)


@contextlib.contextmanager
def two_machines(seed: int = 1) -> Iterator[Machines]:
    """Namespaces ``robot`` and ``operator``, with a relay in user space between them.

    Args:
        seed: Of what the cable does at random.

    Raises:
        PermissionError: Namespaces are not permitted here.
    """
    with _wired(("robot", "operator")) as (found, between, ends):
        words = [*("ip", "netns", "exec", between, sys.executable, "-s", str(RELAY)), *ends]
        found.relay = subprocess.Popen(
            [*words, str(seed)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert found.relay.stdin is not None and found.relay.stdout is not None
        try:
            if found.relay.stdout.readline() != "ok\n":
                raise PermissionError("the relay may not open packet sockets here")
            yield found
        finally:
            found.relay.stdin.close()
            found.relay.wait(10)


@contextlib.contextmanager
def on_a_switch(*machines: str) -> Iterator[Machines]:
    """A namespace for each machine, and a switch between them.

    Raises:
        PermissionError: Namespaces are not permitted here.
    """
    with _wired(machines) as (found, between, ends):
        ip("-n", between, "link", "add", "switch", "up", "type", "bridge")
        for end in ends:
            ip("-n", between, "link", "set", end, "master", "switch")
        yield found
