"""`./surg up CELL --role …`: one machine's part of a cell with several machines."""

from __future__ import annotations

import os
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from surg_cli.graph import (
    follow,
    master,
    network,
    operator_nodes,
    processes,
    roles,
    running,
    system,
)
from surg_cli.graph.system import Node
from surg_cli.graph.system_plan import ENDOSCOPE, SystemPlan
from surg_cli.host import environment
from surg_cli.host.terminal import CliError, Progress, say

LEADER = "crtk"
"""Any leader that speaks CRTK on topics."""
ASK_S = 0.5
"""Period of the checks whether the ROS master answers [s]."""


def link(config: Any, role: roles.Role, port: int, guard: bool | None = None) -> roles.Link:
    """Check this machine's network, and give this process the role's environment.

    Restarts this command with that environment, because it is a ROS node itself. ``guard``: the
    nodes get the port guard. None: as the running role of this machine, which needs it if the
    machine has another address.

    Raises:
        CliError: ROS ports may not be opened here; says what to do.
    """
    place = roles.link_of(config, role, port)
    guard = bool(network.other_addresses(place.address)) if guard is None else guard
    place = replace(place, guard=guard)
    network.check(place.address, role, guard)
    env = place.environment(os.environ, network.GUARD)
    if any(os.environ.get(name) != env.get(name) for name in ("ROS_IP", "SURG_LISTEN_ON")):
        env["SURG_READY"] = "1"
        os.execve(sys.executable, [sys.executable, "-s", "-m", "surg_cli", *sys.argv[1:]], env)
    return place


def nodes(plan: SystemPlan, place: roles.Link | None, leader: str = LEADER) -> list[Node]:
    """The nodes of this machine, without the robot_state_publishers; no place: a single machine."""
    every = system.nodes(plan)
    if place is None:
        return every
    cameras = (f"/{ENDOSCOPE}", f"/{system.EYES}")
    clock = clock_monitor(place.role)
    if place.role is roles.Role.ENDOSCOPE:
        return [*(node for node in every if node.name in cameras), *clock]
    if place.role is roles.Role.OPERATOR:
        page = leader == operator_nodes.BROWSER
        hands = operator_nodes.teleoperation(plan, leader, page)
        if not page:
            return [hands, *clock]
        web = {"port": operator_nodes.WEB_PORT}  # for this machine only
        here = replace(plan, record=False)  # the episodes are the robot's machine's
        return [hands, operator_nodes.console(here, True, web), *clock]
    away = roles.Role.ENDOSCOPE.value in place.others
    return [*(node for node in every if not (away and node.name in cameras)), *clock]


def clock_monitor(role: roles.Role, daemon: Path | None = None) -> list[Node]:
    """The node that monitors this machine's clock, if a PTP daemon runs here."""
    from surg_recording.clock import clock_sync

    socket = daemon or Path(clock_sync.SOCKET)
    if not socket.exists():
        return []
    name, params = f"/clock_sync_{role}", {"socket": str(socket)}
    return [
        Node(name, "surg_recording", "clock_sync_node.py", dict(params), essential=False),
    ]


def warn_without_ptp(place: roles.Link) -> None:
    """Print a warning if no PTP daemon synchronises this machine's clock."""
    if not clock_monitor(place.role):
        kind = "master" if place.role is roles.Role.ROBOT else "slave"
        say(
            "No PTP daemon runs on this machine, so the offset between the machines' stamps is "
            f"unknown. Run sudo ./surg ptp {kind}, then start this role again."
        )


def keep(plan: SystemPlan, place: roles.Link, logs: Path, leader: str) -> int:
    """Join the robot's machine; return on a signal.

    Raises:
        CliError: The master does not answer any more, or a node has ended.
    """
    env = place.environment(environment.for_nodes(ros_home=logs / "ros"), network.GUARD)
    with processes.Supervisor(env, logs) as supervisor:
        _await_master(place)
        cell, role = plan.cell, place.role.value
        with running.announced("up", place.port, cell, logs, role, place.uri) as entry:
            for node in nodes(plan, place, leader):
                system.start(supervisor, node)
            entry.list_nodes(supervisor.children)
            say(f"{cell.name}: this machine, {place.address}, is its {role}; master {place.uri}")
            if any(node == operator_nodes.CONSOLE for node in entry.nodes):
                say(f"Open http://localhost:{operator_nodes.WEB_PORT}/ in a browser.")
            warn_without_ptp(place)
            say(f"Logs: {logs}. Ctrl-C or ./surg down ends it.")
            _stay(place, supervisor)
    return 0


def _await_master(place: roles.Link) -> None:
    """Wait for the robot's machine."""
    patience = place.timeouts.master
    with Progress(f"up: waiting for the robot's machine, {place.uri}"):
        if not processes.wait_until(lambda: master.alive(place.uri), patience, ASK_S):
            raise CliError(
                f"no ROS master answered at {place.uri} within {patience:.0f} s: start the robot's "
                "machine with --role robot, and check the cable and machines.robot = "
                f"{place.robot}"
            )


def _stay(place: roles.Link, supervisor: processes.Supervisor) -> None:
    """Watch the nodes, their ports and the robot's machine; ends with a CliError."""
    heard = time.monotonic()
    while True:
        follow.raise_if_dead(supervisor)
        network.refuse_foreign_ports(supervisor.children, place)
        if master.alive(place.uri):
            heard = time.monotonic()
        elif time.monotonic() - heard > place.timeouts.gone:
            raise CliError(
                f"the robot's machine, {place.robot}, has been silent for "
                f"{place.timeouts.gone:.0f} s: this role ends. The arms hold by themselves. "
                "Start the role again when the link is back; nothing resumes by itself"
            )
        time.sleep(ASK_S)
