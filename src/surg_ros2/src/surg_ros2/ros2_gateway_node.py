"""The node ``/ros2``: the graph's topics for ROS 2, and on request commands from ROS 2.

What ROS 2 sees and may say is the contract of topics. A topic is subscribed while a ROS 2 node
listens, a latched one always.
"""

from __future__ import annotations

import io
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rosgraph
import roslib.message
import rospy
from sensor_msgs.msg import CompressedImage

from surg_ros.byte_topics import as_bytes
from surg_ros.master_check import master_is_online
from surg_ros.params import ParamError, flag, one_of, path, read, text, whole
from surg_ros2 import jpeg
from surg_ros2.bridged_topics import (
    LARGEST_DOMAIN,
    NotBridged,
    Quality,
    Topics,
    caller_name,
    dds_topic,
    dds_type,
)
from surg_ros2.cdr import Codec, Malformed
from surg_ros2.ros2_caller_node import LARGEST, Caller, forked

LOOK = 0.1
"""[s] Between two looks at who has come and gone in DDS."""
ASK = 1.0
"""[s] Between two questions to the ROS master."""
SETTLE = 3.0
"""[s] After the start, until another gateway of the domain is known."""
NAMELESS = 3.0
"""[s] How long a process may be without the name of a ROS 2 node before it gets one."""
EARLY = 4.0
"""[s] How long a command waits for the node of its sender."""
MOST_EARLY = 1000
"""Commands that wait so."""
MOST_CALLERS = 32
"""ROS 2 processes that may send commands at a time."""
MOST_WARNINGS = 1000
"""Different ones of a run."""
OURS = "/ros2"
"""The gateway's node; names of the callers begin with it too."""


@dataclass(frozen=True)
class Parameters:
    """Parameters of the node."""

    contract: Path = path()
    interface: str = text("lo")
    domain: int = whole(0, LARGEST_DOMAIN, default=0)
    commands: bool = flag(False)
    mode: str = one_of(("lockstep", "freerun"), default="freerun")


def fields(kind: str) -> list[tuple[str, str]]:
    """Names and types of the fields of a message type."""
    made = message_class("std_msgs/Header" if kind == "Header" else kind)
    return list(zip(made.__slots__, made._slot_types, strict=True))


def message_class(kind: str) -> Any:
    """The class of a message type.

    Raises:
        NotBridged: It is not built.
    """
    found = roslib.message.get_message_class(kind)
    if found is None:
        raise NotBridged(f"{kind}: no such message is built in this workspace")
    return found


class Outgoing:
    """A topic that ROS 2 sees."""

    def __init__(
        self, port: Any, topic: str, kind: str, quality: Quality, convert: Any = None
    ) -> None:
        self._topic, self._kind, self._latched = topic, kind, quality.latched
        sent, name = (kind, topic) if convert is None else convert.sent(topic)
        self._codec = Codec(sent, fields)
        self._convert = convert
        self._writer = port.writer(dds_topic(name), dds_type(sent), quality)
        self._subscriber: Any = None

    def look(self) -> None:
        """Subscribe if somebody listens, unsubscribe if nobody does."""
        wanted = self._latched or self._writer.readers > 0
        if wanted and self._subscriber is None:
            kind = as_bytes(message_class(self._kind))
            keys = {"queue_size": 10, "tcp_nodelay": True, "buff_size": 1 << 22}
            self._subscriber = rospy.Subscriber(self._topic, kind, self._pass_on, **keys)
        elif not wanted and self._subscriber is not None:
            self._subscriber.unregister()
            self._subscriber = None

    def _pass_on(self, message: Any) -> None:
        if message._connection_header.get("callerid", "").startswith(OURS):
            return  # it came from ROS 2
        data = message.data if self._convert is None else self._convert.convert(message.data)
        if data is not None:
            self._writer.send(self._codec.to_ros2(data))


class Compressed:
    """Makes `.../compressed` of a raw picture."""

    def __init__(self, kind: str) -> None:
        self._class = message_class(kind)

    def sent(self, topic: str) -> tuple[str, str]:
        """Type and name of what is sent."""
        return "sensor_msgs/CompressedImage", f"{topic}/compressed"

    def convert(self, data: bytes) -> bytes | None:
        """The picture as JPEG; None: it cannot be one."""
        image = self._class().deserialize(data)
        picture = jpeg.encode(image)
        if picture is None:
            return None
        packed = io.BytesIO()
        CompressedImage(image.header, "jpeg", picture).serialize(packed)
        return packed.getvalue()


class Incoming:
    """Commands from ROS 2: which process may say what, and its node in ROS 1."""

    def __init__(self, port: Any, warn: Callable[[str, str], None], blocking: bool) -> None:
        self._port, self._warn, self._blocking = port, warn, blocking
        self._context = forked()
        self._readers: dict[str, tuple[str, Any, Codec]] = {}
        self._writers: dict[int, tuple[str, str]] = {}  # handle -> process, topic
        self._names: dict[str, list[str]] = {}
        self._since: dict[str, float] = {}
        self._callers: dict[str, Caller] = {}
        # when it came, writer, topic, sample: commands of processes without a node yet
        self._early: list[tuple[float, int, str, bytes]] = []

    def accept(self, topic: str, kind: str, quality: Quality) -> None:
        """Take commands on a topic."""
        if topic not in self._readers:
            name = dds_topic(topic)
            reader = self._port.reader(name, dds_type(kind), quality)
            self._readers[topic] = (kind, reader, Codec(kind, fields))

    def look(self, now: float) -> None:
        """Notice who has come and gone; ``now`` on the steady clock [s]."""
        changes = self._port.changes()
        self._names = self._port.node_names()
        for writer in changes:
            topic = writer.topic.removeprefix("rt")
            if not writer.type:
                self._writers.pop(writer.handle, None)
            elif writer.topic.startswith("rt/"):
                self._writers[writer.handle] = (writer.process, topic)
                self._since.setdefault(writer.process, now)
                kind = self._readers[topic][0] if topic in self._readers else ""
                if kind and writer.type != dds_type(kind):
                    self._warn(topic, f"a ROS 2 node sends {writer.type}; expected {kind}")
        present: dict[str, set[str]] = {}
        for process, topic in self._writers.values():
            if topic in self._readers:
                present.setdefault(process, set()).add(topic)
        for process in set(self._callers) - set(present):
            self._callers.pop(process).close()
        for process, topics in present.items():
            named = process in self._names or now - self._since[process] > NAMELESS
            if process in self._callers or (named and self._begin(process)):
                for topic in topics:
                    self._callers[process].announce(topic, self._readers[topic][0])
        there = {process for process, _ in self._writers.values()}
        self._since = {each: since for each, since in self._since.items() if each in there}

    def _begin(self, process: str) -> bool:
        """Make the node of a process; returns whether there is one."""
        if len(self._callers) >= MOST_CALLERS:
            self._warn("commands", f"{MOST_CALLERS} ROS 2 processes send already: end one of them")
            return False
        taken = [caller.name for caller in self._callers.values()]
        name = caller_name(self._names.get(process, ()), process, taken)
        self._callers[process] = Caller(name, self._context, self._blocking)
        rospy.loginfo(f"a ROS 2 process sends commands as /{name}")
        return True

    def take(self, now: float) -> None:
        """Pass on what has come; ``now`` on the steady clock [s]."""
        early, self._early = self._early, []
        for came, handle, topic, sample in early:
            self._pass_on(came, handle, topic, sample, now)
        for topic, (_, reader, _) in self._readers.items():
            for handle, sample in reader.take():
                self._pass_on(now, handle, topic, sample, now)

    def _pass_on(self, came: float, handle: int, topic: str, sample: bytes, now: float) -> None:
        """Give a command to its sender's node, or keep it for a while if that is not there yet."""
        caller = self._callers.get(self._writers.get(handle, ("", ""))[0])
        if caller is not None:
            try:
                message = self._readers[topic][2].to_ros1(sample)
            except Malformed as problem:
                cure = "its package has another definition: build it from this workspace's"
                self._warn(f"{topic} {caller.name}", f"from {caller.name}: {problem}; {cure}")
                return
            if len(message) <= LARGEST:
                caller.send(topic, message)
        elif now - came < EARLY and len(self._early) < MOST_EARLY:
            self._early.append((came, handle, topic, sample))
        else:
            self._warn(topic, "a command whose sender did not make itself known was dropped")


class Gateway:
    """The whole node.

    Args:
        port: DDS.
        settings: Its parameters.
    """

    def __init__(self, port: Any, settings: Parameters) -> None:
        self._port = port
        lockstep = settings.mode == "lockstep"
        self._topics = Topics(settings.contract, lockstep)
        self._out: dict[str, Outgoing | None] = {}
        self._in = Incoming(port, self._warn, lockstep) if settings.commands else None
        self._master = rosgraph.Master(rospy.get_name())
        self._warned: set[str] = set()

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

    def _ask(self) -> None:
        """Bridge what has come to the graph."""
        try:
            published, subscribed, _ = self._master.getSystemState()
            kinds = dict(self._master.getTopicTypes())
        except (OSError, rosgraph.MasterException):
            return  # it comes back, or `./surg up` ends
        there = {topic for topic, nodes in published if set(nodes) - {OURS}}
        for topic in sorted(there - set(self._out)):
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

        port = dds_port.Port(settings.domain, settings.interface, time.time_ns())
        gateway = Gateway(port, settings)
    except (ParamError, ValueError, RuntimeError) as error:
        return refuse(str(error))
    except ImportError as error:
        return refuse(f"{error}: ./surg up CELL --ros2 installs it (src/surg_ros2/dds.lock)")
    rospy.loginfo(f"ros2: domain {settings.domain} on {settings.interface}")
    return gateway.run()


if __name__ == "__main__":
    sys.exit(main())
