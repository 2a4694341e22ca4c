"""`./surg dev topics`: compare a running graph with topics.yaml, and make topics.md of that."""

from __future__ import annotations

import argparse
import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from surg_cli.graph import master, system
from surg_cli.graph.graph_probe import GraphEnd, observe
from surg_cli.graph.processes import Supervisor, wait_until
from surg_cli.graph.topic_contract import PAGE, Contract, compare, load, render
from surg_cli.host import paths
from surg_cli.host.terminal import CliError, say, warn

ARM = "PSM1"
NODES = ("sim", "controller", "dvrk_compat")
"""Base names of the nodes on the reference graph."""
_UP_S = 30.0


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """There are no options."""


def main(options: argparse.Namespace, command: str) -> int:
    """Start the reference graph, compare, and write the page."""
    contract = load()
    with reference_graph(contract) as seen:
        wrong = compare(contract, seen, ARM, NODES, lockstep=False)
    for sentence in wrong:
        warn(f"surg: {sentence}")
    if wrong:
        return 1
    name, page = PAGE.relative_to(paths.ROOT), render(contract)
    same = PAGE.exists() and PAGE.read_text("utf-8") == page
    PAGE.write_text(page, "utf-8")
    say(f"{name} is up to date" if same else f"wrote {name}")
    return 0


@contextlib.contextmanager
def reference_graph(contract: Contract) -> Iterator[list[GraphEnd]]:
    """Simulator, controller with everything on, and the dVRK node, in free-run on a private master.

    Yields its topics and services once they fulfil the contract, or after a timeout.

    Raises:
        CliError: A node ends.
    """
    with tempfile.TemporaryDirectory(prefix="surg_topics_") as folder:
        env = {**os.environ, "ROS_IP": "127.0.0.1", "ROS_HOSTNAME": "localhost"}
        env.update(ROS_HOME=folder, ROS_LOG_DIR=folder)
        with Supervisor(env, Path(folder) / "logs") as supervisor:
            master.start(supervisor, master.free_port())
            for node in reference_nodes("freerun"):
                system.start(supervisor, node)
            yield await_graph(supervisor, contract)


def reference_nodes(mode: str) -> list[system.Node]:
    """The nodes of the reference graph, with every optional topic."""
    cell = str(paths.ROOT / "cells" / "sim_ur5e")
    shared = {"cell": cell, "mode": mode}
    return [
        system.Node(
            "/sim", "surg_sim", "bridge_node.py", {**shared, "inject": True, "track_stale": 0.02}
        ),
        system.Node(
            f"/{ARM}/controller",
            "surg_control",
            "rcm_node",
            {**shared, "arm": ARM, "track_rcm": True},
        ),
        system.Node("/dvrk_compat", "surg_dvrk_compat", "dvrk_compat_node.py", {"arms": [ARM]}),
    ]


def await_graph(supervisor: Supervisor, contract: Contract) -> list[GraphEnd]:
    """Topics and services of the graph once it fulfils the contract, or after a timeout."""
    uri = supervisor.env["ROS_MASTER_URI"]
    seen: list[GraphEnd] = []

    def up() -> bool:
        nonlocal seen
        dead = supervisor.first_dead()
        if dead is not None:
            raise CliError(f"{dead.name} ended:\n{dead.log_tail()}")
        with contextlib.suppress(OSError, CliError):
            seen = observe(uri)
        return bool(seen) and not compare(contract, seen, ARM, NODES, lockstep=False)

    wait_until(up, _UP_S, 0.2)
    return seen
