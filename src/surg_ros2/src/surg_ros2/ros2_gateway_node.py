"""The node ``/ros2``: the graph's topics and services for ROS 2, and on request commands from it.

What ROS 2 sees and may say is the contract docs/reference/topics.yaml.
"""

from __future__ import annotations

import importlib.util
import multiprocessing
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import rosgraph
import rospy

from surg_ros.master_check import master_is_online
from surg_ros.params import ParamError, flag, one_of, path, read, text, whole
from surg_ros2.bridged_topics import IMPLEMENTATIONS, LARGEST_DOMAIN, OURS, NotBridged, Topics
from surg_ros2.enclave import check
from surg_ros2.incoming_node import Incoming
from surg_ros2.outgoing_node import Compressed, Outgoing
from surg_ros2.ros2_caller_node import forked

LOOK = 0.1
"""[s] Between two looks at who has come and gone in DDS."""
ASK = 1.0
"""[s] Between two questions to the ROS master."""
SETTLE = 3.0
"""[s] After the start, until another gateway of the domain is known."""
MOST_WARNINGS = 1000
"""Different ones of a run."""
_CYCLONE = f"RMW_IMPLEMENTATION={IMPLEMENTATIONS[1]}"


@dataclass(frozen=True)
class Parameters:
    """Parameters of the node."""

    contract: Path = path()
    interface: str = text("lo")
    domain: int = whole(0, LARGEST_DOMAIN, default=0)
    commands: bool = flag(False)
    implementation: str = one_of(IMPLEMENTATIONS, default=IMPLEMENTATIONS[0])
    enclave: Path | None = path(None)
    mode: str = one_of(("lockstep", "freerun"), default="freerun")


class Gateway:
    """The whole node.

    Args:
        port: DDS.
        settings: Its parameters.
    """

    def __init__(self, port: Any, settings: Parameters) -> None:
        self._port = port
        self._settings = settings
        lockstep = settings.mode == "lockstep"
        self._topics = Topics(settings.contract, lockstep)
        self._out: dict[str, Outgoing | None] = {}
        self._in = Incoming(port, self._warn, lockstep) if settings.commands else None
        self._master = rosgraph.Master(rospy.get_name())
        self._warned: set[str] = set()
        self._services: Connection | None = None
        self._serves = settings.enclave is None or settings.implementation != IMPLEMENTATIONS[0]
        if not self._serves:
            self._warn("services", f"none in a secured domain without {_CYCLONE}")

    def run(self) -> int:
        """Until the node is asked to end: 0; or another gateway is there: 2."""
        begun, asked, looked = time.monotonic(), -ASK, -LOOK
        while not rospy.is_shutdown():
            now = time.monotonic()
            if now - asked >= ASK:
                asked = now
                self._ask()
                if now - begun < SETTLE and not self._port.first_gateway():
                    return second()
                if now - begun >= SETTLE and self._services is None and self._serves:
                    self._services = self._serve()
            if now - looked >= LOOK:
                looked = now
                for topic in list(self._out.values()):
                    if topic is not None:
                        topic.look()
                if self._in is not None:
                    self._in.look(now)
            self._port.wait(LOOK)
            if self._in is not None:
                self._in.take(time.monotonic())
        return 0

    def _serve(self) -> Connection:
        """Start the child process of the services; it ends when this end of the pipe does."""
        from surg_ros2.ros2_services_node import run as serve  # it needs DDS: main says so first

        ours, theirs = multiprocessing.Pipe()
        of = self._settings
        words = (self._topics, of.implementation, of.domain, of.interface, of.enclave, theirs)
        child = forked().Process(target=serve, args=words, daemon=True)

        def start() -> None:
            child.start()
            theirs.close()

        threading.Thread(target=start, daemon=True).start()
        return ours

    def _ask(self) -> None:
        """Bridge what has come to the graph."""
        try:
            published, subscribed, _ = self._master.getSystemState()
            kinds = dict(self._master.getTopicTypes())
        except (OSError, rosgraph.MasterException):
            return  # it comes back, or `./surg up` ends
        there = {topic for topic, nodes in published if set(nodes) - {OURS}}
        for topic in sorted(there):
            if (offered := self._out.get(topic)) is not None:
                offered.appeared(topic)
            elif topic not in self._out:
                self._guarded(topic, self._offer, kinds.get(topic, "*"), there)
        for topic, nodes in subscribed:
            if set(nodes) - {OURS}:
                self._guarded(topic, self._accept, kinds.get(topic, "*"))

    def _offer(self, topic: str, kind: str, there: set[str]) -> None:
        quality = self._topics.outgoing(topic, kind)
        if quality is None:
            return
        self._out[topic] = None  # what fails is not tried again
        self._out[topic] = Outgoing(self._port, topic, kind, quality)
        compressed = f"{topic}/compressed"
        if kind == "sensor_msgs/Image" and compressed not in there:
            self._out[compressed] = Outgoing(self._port, topic, kind, quality, Compressed(kind))

    def _accept(self, topic: str, kind: str) -> None:
        quality = self._topics.incoming(topic, kind)
        if self._in is not None and quality is not None:
            self._in.accept(topic, kind, quality)

    def _guarded(self, topic: str, bridge: Callable[..., None], *of: Any) -> None:
        try:
            bridge(topic, *of)
        except (NotBridged, RuntimeError) as problem:
            self._warn(topic, str(problem))

    def _warn(self, key: str, why: str) -> None:
        """Say once what is wrong; a peer with ever new names is told of so many times only."""
        if key not in self._warned and len(self._warned) < MOST_WARNINGS:
            self._warned.add(key)
            rospy.logwarn(f"ros2: {key}: {why}")


def second() -> int:
    """Another gateway has the domain."""
    return refuse(
        "another gateway runs in this ROS 2 domain: end it, or set ROS_DOMAIN_ID to another number "
        "here and for the ROS 2 nodes of this system"
    )


def refuse(why: str) -> int:
    """Say why there is no gateway."""
    print(f"ros2: {why}", file=sys.stderr, flush=True)
    return 2


def main() -> int:
    """Run the node; returns the exit code (0: ended, 2: it must not run so)."""
    if not master_is_online("ros2"):
        return 1
    rospy.init_node("ros2")
    try:
        settings = read(Parameters, rospy.get_param("~", {}))
        from surg_ros2 import dds_port

        if importlib.util.find_spec("roswell") is None:  # its child would end without a word
            raise ImportError("No module named 'roswell'")
        if settings.enclave is not None:
            check(settings.enclave)
        where = (settings.domain, settings.interface)
        port = dds_port.Port(*where, time.time_ns(), settings.enclave)
        gateway = Gateway(port, settings)
    except (ParamError, ValueError, RuntimeError) as error:
        return refuse(str(error))
    except ImportError as error:
        return refuse(f"{error}: ./surg up CELL --ros2 installs it (src/surg_ros2/dds.lock)")
    how = "open" if settings.enclave is None else f"secured by {settings.enclave}"
    rospy.loginfo(f"ros2: domain {settings.domain} on {settings.interface}, {how}")
    return gateway.run()


if __name__ == "__main__":
    sys.exit(main())
