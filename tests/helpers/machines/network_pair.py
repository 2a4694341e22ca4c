"""Two network namespaces joined by a veth pair: two machines on one wire, for tests."""

from __future__ import annotations

import contextlib
import os
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass

IP = "/usr/sbin/ip"


@dataclass(frozen=True)
class Ends:
    """One machine each.

    Attributes:
        names: Of the namespaces.
        interfaces: Of their ends of the wire.
    """

    names: tuple[str, str]
    interfaces: tuple[str, str]

    def inside(self, machine: int) -> list[str]:
        """Words before a command that shall run on machine 0 or 1."""
        return [IP, "netns", "exec", self.names[machine]]


@contextlib.contextmanager
def joined() -> Iterator[Ends]:
    """Make the pair; it is removed afterwards.

    Raises:
        OSError: Namespaces are not permitted here, with the reason.
    """
    tag = f"st{os.getpid() % 100_000}"
    ends = Ends((f"{tag}a", f"{tag}b"), (f"{tag}x", f"{tag}y"))
    try:
        for name in ends.names:
            _ip("netns", "add", name)
        a, b = ends.names
        wire = ("link", "add", ends.interfaces[0], "netns", a, "type", "veth")
        _ip(*wire, "peer", "name", ends.interfaces[1], "netns", b)
        for k in range(2):
            inside = ("-n", ends.names[k])
            _ip(*inside, "addr", "add", f"10.77.0.{k + 1}/24", "dev", ends.interfaces[k])
            _ip(*inside, "link", "set", ends.interfaces[k], "up")
            _ip(*inside, "link", "set", "lo", "up")
        yield ends
    finally:
        for name in ends.names:
            with contextlib.suppress(OSError):
                _ip("netns", "del", name)


def _ip(*words: str) -> None:
    done = subprocess.run([IP, *words], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise OSError(f"ip {' '.join(words)}: {done.stderr.strip()}")
