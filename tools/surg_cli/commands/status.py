"""`./surg status`: every node, topic rate and last error of the running systems."""

from __future__ import annotations

import argparse
import threading
import time
from collections import defaultdict

from surg_cli.graph import master, processes, running
from surg_cli.host.option_types import tcp_port
from surg_cli.host.terminal import say, table

LISTEN_S = 2.0
RECEIVED = "/received"
"""Topic below an arm by which its controller repeats every command."""


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    parser.add_argument("--port", type=tcp_port, metavar="P", help="of the ROS master")


def main(options: argparse.Namespace, command: str) -> int:
    """Describe one system; exit status 1 if there is none or a node is missing."""
    systems = running.systems(options.port)
    if not systems and options.port is None:
        say("status: no system of this checkout is running (./surg up CELL starts one)")
        return 1
    for other in systems[1:]:
        say(f"also running: {other.command} of {other.cell}, ./surg status --port {other.port}")
    port = systems[0].port if systems else options.port
    uri = systems[0].master_uri if systems else f"http://localhost:{port}"
    registered = master.nodes(uri)
    healthy = _nodes(systems[0] if systems else None, registered, uri)
    _topics(uri)
    if systems:
        _errors(systems[0])
    return 0 if healthy else 1


def _nodes(system: running.System | None, registered: list[str], uri: str) -> bool:
    """Print every node; return whether all started nodes run."""
    rows = []
    healthy = True
    started = dict(system.nodes) if system else {}
    for name in sorted({*registered, *started} - {"rosmaster"}):
        pid = started.get(name)
        if pid is None:
            state = "registered"
        elif processes.start_time(pid) is None:
            state, healthy = "DEAD", False
        else:
            state = "running" if name in registered else "not registered yet"
        rows.append([name, state, "" if pid is None else f"pid {pid}"])
    title = f"{system.command} of {system.cell}" if system else "a system of another checkout"
    say(f"{title}, ROS master {uri}\nnodes:\n{table(rows)}")
    return healthy


def _topics(uri: str) -> None:
    """Count the messages of every topic for two seconds and print the rates."""
    import rospy

    from surg_msgs.msg import ReceivedCommand
    from surg_ros.arm_port import MOTION_COMMANDS, OTHER_COMMANDS

    publications = master.publications(uri)
    arms = [topic[: -len(RECEIVED)] for topic in publications if topic.endswith(RECEIVED)]
    commands = {f"{a}/{name}" for a in arms for name in (*MOTION_COMMANDS, *OTHER_COMMANDS, "hold")}
    counts: dict[str, int] = defaultdict(int)
    lock = threading.Lock()

    def count(message: object, topic: str) -> None:
        with lock:
            counts[topic] += 1
            if isinstance(message, ReceivedCommand):
                counts[f"{topic[: -len(RECEIVED)]}/{message.topic}"] += 1

    with master.joined(uri, "surg_status"):
        for topic in publications.keys() - commands:
            # AnyMsg: counted without decoding. A command is heard of from the controller alone.
            kind = ReceivedCommand if topic.endswith(RECEIVED) else rospy.AnyMsg
            rospy.Subscriber(topic, kind, count, topic, queue_size=None, tcp_nodelay=True)
        time.sleep(0.5)  # connections and latched messages
        with lock:
            before = dict(counts)
        time.sleep(LISTEN_S)
        with lock:
            after = dict(counts)
    rows = []
    for topic in sorted(publications):
        rate = (after.get(topic, 0) - before.get(topic, 0)) / LISTEN_S
        shown = f"{rate:7.1f} Hz" if rate else ("  latched" if after.get(topic) else "   silent")
        rows.append([topic, shown, ", ".join(publications[topic])])
    say(f"topics:\n{table(rows)}")


def _errors(system: running.System) -> None:
    """Print the newest error of every arm."""
    rows = [[arm, text or "none"] for arm, text in system.last_errors.items()] or [["none", ""]]
    say(f"last errors:\n{table(rows)}\nlogs: {system.logs}")
