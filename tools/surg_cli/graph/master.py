"""The ROS master: a free port, `rosmaster --core`, and asking it what there is."""

from __future__ import annotations

import contextlib
import os
import socket
import xmlrpc.client
from collections.abc import Iterator, Mapping
from typing import Any

from surg_cli.graph.processes import Child, Supervisor, wait_until
from surg_cli.host.terminal import CliError

ROSMASTER = ("/usr/bin/python3", "-s", "/usr/bin/rosmaster", "--core")
"""Debian's Python is named: the script's shebang may meet another one on PATH."""
DEFAULT_PORT = 11311
START_TIMEOUT_S = 15.0


class _Transport(xmlrpc.client.Transport):
    """Gives up after five seconds: a stopped master must not hang a command."""

    def make_connection(self, host: Any) -> Any:
        connection = super().make_connection(host)
        connection.timeout = 5.0
        return connection


def free_port() -> int:
    """A TCP port of the loopback interface that nobody uses now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def port_in_use(port: int, host: str = "127.0.0.1") -> bool:
    """Whether something listens on a TCP port of this machine, at one of its addresses."""
    with socket.socket() as probe:
        probe.settimeout(1.0)
        return probe.connect_ex((host, port)) == 0


def call(uri: str, method: str, *arguments: object) -> Any:
    """Call a method of the master's XML-RPC interface; returns the value of the answer.

    Raises:
        CliError: No master answers there, or it refuses.
    """
    proxy = xmlrpc.client.ServerProxy(uri, transport=_Transport())
    try:
        code, text, value = getattr(proxy, method)("/surg_cli", *arguments)
    except (OSError, xmlrpc.client.Error, ValueError) as error:
        raise CliError(
            f"no ROS master answers at {uri} ({error}); start a system with ./surg up CELL, "
            "or name its port with --port"
        ) from error
    if code != 1:
        raise CliError(f"the ROS master refused {method}{arguments}: {text}")
    return value


def parameter(uri: str, name: str) -> Any:
    """A parameter's value, a dictionary for a namespace; None: there is none.

    Raises:
        CliError: No master answers there.
    """
    return call(uri, "getParam", name) if call(uri, "hasParam", name) else None


def alive(uri: str) -> bool:
    """Whether a ROS master answers at `uri`."""
    try:
        call(uri, "getPid")
    except CliError:
        return False
    return True


def start(supervisor: Supervisor, port: int, host: str = "localhost") -> Child:
    """Start `rosmaster --core` as the supervisor's first child, and wait until it answers.

    Sets ROS_MASTER_URI in the supervisor's environment; ``host`` is this machine's address for the
    other nodes.

    Raises:
        CliError: The port is taken, or the master does not come up.
    """
    if port_in_use(port, host):
        raise CliError(
            f"port {port} is in use on this machine: choose another with --port, or end what "
            f"holds it (ss -ltnp 'sport = :{port}' names it)",
            2,
        )
    uri = f"http://{host}:{port}"
    supervisor.env["ROS_MASTER_URI"] = uri
    child = supervisor.start("rosmaster", [*ROSMASTER, "-p", str(port)])
    if not wait_until(lambda: alive(uri) or child.exit_code is not None, START_TIMEOUT_S):
        raise CliError(f"the ROS master did not answer on port {port} within {START_TIMEOUT_S} s")
    if child.exit_code is not None:
        raise CliError(f"the ROS master ended at once:\n{child.log_tail()}")
    return child


@contextlib.contextmanager
def joined(uri: str, name: str, anonymous: bool = True) -> Iterator[None]:
    """Be a node of the graph at ``uri`` while the context lasts; a process can be one once.

    One that is not anonymous ends another node of its name.
    """
    os.environ["ROS_MASTER_URI"] = uri
    import rospy

    rospy.init_node(name, anonymous=anonymous, disable_signals=True)
    try:
        yield
    finally:
        rospy.signal_shutdown("done")


def nodes(uri: str) -> list[str]:
    """Names of all registered nodes, sorted."""
    publishers, subscribers, services = call(uri, "getSystemState")
    return sorted(
        {
            node
            for group in (publishers, subscribers, services)
            for _, names in group
            for node in names
        }
    )


def publications(uri: str) -> Mapping[str, list[str]]:
    """Topic -> the nodes that publish it."""
    return {topic: list(names) for topic, names in call(uri, "getSystemState")[0]}
