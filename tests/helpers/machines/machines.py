"""Machines on one cable, or on a switch: network namespaces, joined by a relay or a bridge."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from helpers.endoscope_files import copied_cell

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
def _namespaces(machines: Sequence[str], *more: str) -> Iterator[Machines]:
    """A namespace for each machine, and others by name; nothing of them reaches a network."""
    pid = os.getpid()
    found = Machines(
        {machine: f"surg{pid}{machine[0]}" for machine in machines},
        {machine: f"10.77.0.{k + 1}" for k, machine in enumerate(machines)},
        {machine: f"s{pid}{machine[0]}" for machine in machines},
    )
    made: list[str] = []
    try:
        for name in (*more, *found.names.values()):
            ip("netns", "add", name)
            made.append(name)
            ip("-n", name, "link", "set", "lo", "up")
        yield found
    finally:
        for name in made:
            with contextlib.suppress(PermissionError):
                ip("netns", "del", name)


def _connect(found: Machines) -> None:
    """Give each machine's end of a wire its address."""
    for machine, interface in found.interfaces.items():
        inside = ("-n", found.names[machine])
        ip(*inside, "addr", "add", f"{found.addresses[machine]}/24", "dev", interface)
        ip(*inside, "link", "set", interface, "up")


@contextlib.contextmanager
def _wired(machines: Sequence[str]) -> Iterator[tuple[Machines, str, list[str]]]:
    """Namespaces of machines, that of what lies between them, and the ends of their wires there."""
    between, ends = f"surg{os.getpid()}c", []
    with _namespaces(machines, between) as found:
        for machine, inner in found.interfaces.items():
            ends.append(outer := f"c{os.getpid()}{machine[0]}")
            ip("-n", between, "link", "add", outer, "type", "veth", "peer", "name", inner)
            ip("-n", between, "link", "set", inner, "netns", found.names[machine])
            ip("-n", between, "link", "set", outer, "up")
        _connect(found)
        yield found, between, ends


@contextlib.contextmanager
def on_one_wire(*machines: str) -> Iterator[Machines]:
    """Two machines with nothing between them.

    Raises:
        PermissionError: Namespaces are not permitted here.
    """
    with _namespaces(machines) as found:
        (a, first), (b, second) = found.interfaces.items()
        wire = ("link", "add", first, "netns", found.names[a], "type", "veth")
        ip(*wire, "peer", "name", second, "netns", found.names[b])
        _connect(found)
        yield found


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


def isolated_cell(machines: Machines, folder: Path, **more: object) -> Path:
    """A copy of the simulated UR5e's cell on these machines; ``more`` of its cell.yaml."""
    cell = copied_cell(folder, "sim_ur5e")
    content = yaml.safe_load((cell / "cell.yaml").read_text("utf-8"))
    content.update(network="isolated", machines=dict(machines.addresses), **more)
    (cell / "cell.yaml").write_text(yaml.safe_dump(content, sort_keys=False), "utf-8")
    return cell
