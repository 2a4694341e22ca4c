"""Which Linux distribution this is, and whether the platform has been tried on it."""

from __future__ import annotations

import platform
import sys
from dataclasses import dataclass
from pathlib import Path

from surg_cli.host.terminal import CliError

RELEASE = Path("/etc/os-release")
TRIED = {("debian", "12", "x86_64"), ("debian", "13", "x86_64")}
OLDEST_PYTHON = (3, 11)
ELSEWHERE = "use the Dockerfile in CONTRIBUTING.md, or surg_core alone, without ROS (README.md)"
OTHER_NAMES = {"ubuntu": {"chromium": "chromium-browser"}}
"""Debian's package names that another distribution spells otherwise."""


@dataclass(frozen=True)
class Distribution:
    """A distribution, the processor and the Python that it has.

    Attributes:
        id: Such as ``debian``.
        version: Such as ``13``.
        title: For people.
        like: Words of ID_LIKE.
        machine: Such as ``x86_64``.
        python: Of /usr/bin/python3.
    """

    id: str
    version: str
    title: str
    like: tuple[str, ...] = ()
    machine: str = "x86_64"
    python: tuple[int, int] = OLDEST_PYTHON

    @property
    def tried(self) -> bool:
        """Whether demo and tests have run here."""
        return (self.id, self.version, self.machine) in TRIED

    @property
    def key(self) -> str:
        """What programs built here need: another machine with this key can use them."""
        return f"{self.id} {self.version} {self.machine} Python {self.python[0]}.{self.python[1]}"

    def package(self, name: str) -> str:
        """What a package of Debian is called here."""
        return OTHER_NAMES.get(self.id, {}).get(name, name)

    def untried(self) -> str:
        """What to say before the set-up; empty where it has been tried.

        Raises:
            CliError: It cannot work: the system is not of Debian's kind, or its Python is too old.
        """
        if "debian" not in (self.id, *self.like):
            raise CliError(f"{self.title} has no Debian packages; {ELSEWHERE}", code=2)
        if self.python < OLDEST_PYTHON:
            found, least = (".".join(map(str, each)) for each in (self.python, OLDEST_PYTHON))
            raise CliError(
                f"{self.title} has Python {found}, and {least} or later is needed; {ELSEWHERE}",
                code=2,
            )
        if self.tried:
            return ""
        return (
            f"{self.title} on {self.machine} is untried (Debian 13 and 12 on x86_64 are tried): "
            f"setting up with Debian's package names. If that fails: {ELSEWHERE}"
        )


def here(release: Path = RELEASE) -> Distribution:
    """This machine's."""
    lines = release.read_text("utf-8").splitlines() if release.exists() else []
    words = {
        key: value.strip("\"'") for key, found, value in (x.partition("=") for x in lines) if found
    }
    return Distribution(
        id=words.get("ID", "linux"),
        version=words.get("VERSION_ID", ""),
        title=words.get("PRETTY_NAME", "This system"),
        like=tuple(words.get("ID_LIKE", "").split()),
        machine=platform.machine(),
        python=sys.version_info[:2],
    )
