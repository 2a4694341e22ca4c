"""The services of the contract for ROS 2: a child process of the gateway.

A reply says which request it answers, and the implementations of ROS 2 on DDS say it in two ways,
so that clients and servers of a domain must use one of them:

- rmw_cyclonedds sends 16 bytes before the fields of a request, and wants them back in the reply;
- rmw_fastrtps compares identities in the headers of RTPS. ``cyclonedds`` does not show them;
  ``roswell`` does.
"""

from __future__ import annotations

import signal
import tempfile
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import rosgraph
import rospy

from surg_ros2.bridged_topics import IMPLEMENTATIONS, NotBridged, Quality, Topics, dds_service
from surg_ros2.cdr import HEADER, Malformed
from surg_ros2.dds_port import Port, hold_to
from surg_ros2.message_types_node import codec, definition_files, packed, service_class

NODE = "ros2_services"
"""Its node, in ROS 1 and in ROS 2."""
ASK = 1.0
"""[s] Between two questions to the ROS master."""
LOOK = 0.1
"""[s] Longest wait for a request."""
IDENTITY = 16
"""[bytes] By which a client of rmw_cyclonedds knows its request."""
REQUESTS = Quality(depth=100)
"""Several clients may ask at once."""


class Service:
    """One service of the graph.

    Args:
        name: In the graph.
        kind: Its type.

    Raises:
        NotBridged: The type is not built.
    """

    def __init__(self, name: str, kind: str) -> None:
        self.name, self.kind = name, kind
        self.made = service_class(kind)
        self._proxy = rospy.ServiceProxy(name, self.made)

    def ask(self, request: Any) -> Any:
        """The answer, or an empty one whose ``message`` says why there is none."""
        try:
            return self._proxy(request)
        except (
            rospy.ServiceException,
            rospy.ROSException,
            rospy.exceptions.ROSInternalException,
        ) as error:
            answer = self.made._response_class()
            if hasattr(answer, "message"):
                answer.message = f"{self.name}: {error}"
            return answer


class CycloneServer:
    """A service for clients of rmw_cyclonedds."""

    def __init__(self, port: Port, service: Service) -> None:
        (asked, question), (told, answer) = dds_service(service.name, service.kind)
        self._service = service
        self._request = codec(service.made._request_class)
        self._reply = codec(service.made._response_class)
        self._reader = port.reader(asked, question, REQUESTS)
        self._writer = port.writer(told, answer, REQUESTS)

    def answer(self) -> None:
        """Answer what has come."""
        begin = len(HEADER) + IDENTITY
        for _, sample in self._reader.take():
            try:
                data = self._request.to_ros1(sample[: len(HEADER)] + sample[begin:])
            except Malformed as problem:
                rospy.logwarn_once(f"ros2: {self._service.name}: {problem}")
                continue
            answer = self._service.ask(self._service.made._request_class().deserialize(data))
            reply = self._reply.to_ros2(packed(answer))
            self._writer.send(HEADER + sample[len(HEADER) : begin] + reply[len(HEADER) :])


class Cyclone:
    """The servers for rmw_cyclonedds."""

    def __init__(self, domain: int, interface: str, enclave: Path | None) -> None:
        self._port = Port(domain, interface, enclave=enclave)
        self._servers: list[CycloneServer] = []

    def offer(self, service: Service) -> None:
        """Serve it."""
        self._servers.append(CycloneServer(self._port, service))

    def answer(self, seconds: float) -> None:
        """Answer what comes, for some seconds at most."""
        self._port.wait(seconds)
        self._port.node_names()  # else they would end each wait
        for server in self._servers:
            server.answer()


class Fast:
    """The servers for rmw_fastrtps; `roswell` answers in threads of its own."""

    def __init__(self, domain: int, interface: str) -> None:
        import roswell

        self._failed = roswell.RoswellError
        self._node = roswell.Node(NODE, domain=domain)
        hold_to(interface)  # it has begun to use all
        self._servers: list[Any] = []

    def offer(self, service: Service) -> None:
        """Serve it.

        Raises:
            NotBridged: `roswell` does not take its types.
        """
        with tempfile.TemporaryDirectory() as folder:
            files = definition_files(service.kind, Path(folder))
            try:
                kinds = self._node.load_service(*files)
            except self._failed as error:
                raise NotBridged(f"{service.kind}: {error}") from error

        def answer(theirs: Any) -> Any:
            request, reply = service.made._request_class(), kinds[1].alloc()
            copy(theirs, request)
            copy(service.ask(request), reply)
            return reply

        self._servers.append(self._node.serve(service.name, kinds, answer))

    def answer(self, seconds: float) -> None:
        """Wait for some seconds."""
        time.sleep(seconds)


def copy(source: Any, target: Any) -> None:
    """Copy all fields of a message, to or from one of ROS 1."""
    ours = source if hasattr(source, "_slot_types") else target
    for name in ours.__slots__:
        value = getattr(source, name)
        if hasattr(getattr(ours, name), "_slot_types"):
            copy(value, getattr(target, name))
        else:
            setattr(target, name, value)


def run(
    topics: Topics,
    implementation: str,
    domain: int,
    interface: str,
    enclave: Path | None,
    gateway: Connection,
) -> None:
    """The child process: serve until the gateway's end of the pipe is closed.

    ``enclave`` is for rmw_cyclonedds only: `roswell` has no DDS Security.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    rospy.init_node(NODE, disable_signals=True)
    try:
        servers: Fast | Cyclone
        if implementation == IMPLEMENTATIONS[0]:
            servers = Fast(domain, interface)
        else:
            servers = Cyclone(domain, interface, enclave)
        graph, seen, asked = rosgraph.Master(NODE), set[str](), -ASK
        while not rospy.is_shutdown() and not gateway.poll():
            if time.monotonic() - asked >= ASK:
                asked = time.monotonic()
                offer_new(topics, graph, seen, servers)
            servers.answer(LOOK)
    finally:
        rospy.signal_shutdown("the gateway has ended")


def offer_new(topics: Topics, graph: Any, seen: set[str], servers: Fast | Cyclone) -> None:
    """Offer the services that have come to the graph; ``seen`` gets their names."""
    try:
        there = {name for name, _ in graph.getSystemState()[2]}
    except (OSError, rosgraph.MasterException):
        return  # it comes back, or `./surg up` ends
    for name in sorted(there - seen):
        seen.add(name)
        kind = topics.service(name)
        try:
            if kind is not None:
                servers.offer(Service(name, kind))
        except (NotBridged, RuntimeError) as problem:
            rospy.logwarn(f"ros2: {name}: {problem}")
