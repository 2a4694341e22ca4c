"""The list of running systems: one small file per ROS master port and role in `.surg/run/`."""

from __future__ import annotations

import contextlib
import json
import os
import signal
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

from surg_cli.graph import master, processes
from surg_cli.graph.watch import PAUSE_SIGNAL
from surg_cli.host import environment, paths
from surg_cli.host.terminal import CliError


@dataclass
class System:
    """A running `up`, `demo`, `run` or `teleop`."""

    port: int  # port of its ROS master
    pid: int  # the supervising process
    start_time: int  # of that process; distinguishes a reused process id
    command: str  # `up` or `demo`
    cell: str  # folder of the cell
    logs: str
    nodes: dict[str, int] = field(default_factory=dict)  # node name -> process id
    last_errors: dict[str, str] = field(default_factory=dict)  # arm -> its newest error
    role: str = ""  # of this machine in a cell of several machines; empty with one machine
    uri: str = ""  # ROS_MASTER_URI; empty for the port on this machine

    @property
    def file(self) -> Path:
        """Where it is written."""
        return paths.SYSTEMS / f"{tag(self.port, self.role)}.json"

    @property
    def master_uri(self) -> str:
        """Where its ROS master is."""
        return self.uri or f"http://localhost:{self.port}"

    @property
    def alive(self) -> bool:
        """Whether the supervising process still runs."""
        return processes.start_time(self.pid) == self.start_time

    def list_nodes(self, children: Iterable[processes.Child]) -> None:
        """Write the names and process ids of the running nodes."""
        self.nodes = {child.name: child.process.pid for child in children}
        self.save()

    def save(self) -> None:
        """Write or renew the file."""
        paths.write_text(self.file, json.dumps(asdict(self), indent=1) + "\n")


def tag(port: int, role: str = "") -> str:
    """Name of a system's files: its port, with its role if it has one."""
    return f"{port}_{role}" if role else str(port)


@contextlib.contextmanager
def announced(
    command: str, port: int, cell: Path, logs: Path, role: str = "", uri: str = ""
) -> Iterator[System]:
    """List this process as the supervisor of a system while the context lasts; yields the entry."""
    pid = os.getpid()
    signal.signal(
        PAUSE_SIGNAL, signal.SIG_IGN
    )  # until a Watch listens, `./surg stop` asks the arms
    system = System(
        port,
        pid,
        processes.start_time(pid) or 0,
        command,
        str(cell),
        str(logs),
        role=role,
        uri=uri,
    )
    system.save()
    try:
        yield system
    finally:
        system.file.unlink(missing_ok=True)


@contextlib.contextmanager
def launched(
    command: str, cell: Path, out: Path, port: int | None = None
) -> Iterator[tuple[processes.Supervisor, System]]:
    """A ROS master under a supervisor, listed as running; all children end with the context.

    This process becomes part of the same graph. Logs go to ``out``; without a port a free one.
    """
    env = environment.for_nodes(ros_home=out / "logs" / "ros")
    with processes.orphans_adopted(), processes.Supervisor(env, out / "logs") as supervisor:
        port = port or master.free_port()
        master.start(supervisor, port)
        os.environ.update(supervisor.env)
        with announced(command, port, cell, supervisor.logs) as entry:
            yield supervisor, entry


def of_cell(cell: Path, port: int | None = None) -> System | None:
    """The running `up` or `teleop` of a cell; on a port only that one.

    Raises:
        CliError: Nothing runs on the port, or another cell does.
    """
    found = systems(port)
    if port is not None and not found:
        raise CliError(f"no system of this checkout runs on port {port}; see ./surg status")
    mine = [s for s in found if Path(s.cell) == cell and s.command in ("up", "teleop")]
    if port is not None and not mine:
        raise CliError(f"the system on port {port} is of {found[0].cell}, not of {cell}")
    return mine[0] if mine else None


def systems(port: int | None = None) -> list[System]:
    """Running systems of this checkout, by port, or on one port; drops entries of dead ones."""
    alive = []
    for file in sorted(paths.SYSTEMS.glob("*.json")):
        try:
            system = System(**json.loads(file.read_text("utf-8")))
        except (OSError, ValueError, TypeError):
            continue
        if not system.alive:
            file.unlink(missing_ok=True)
        elif port in (None, system.port):
            alive.append(system)
    return alive
