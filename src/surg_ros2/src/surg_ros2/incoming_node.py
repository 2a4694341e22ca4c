"""What ROS 2 may say: which of its processes sends which command, and its node in ROS 1."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import rospy

from surg_ros2.bridged_topics import Quality, caller_name, dds_topic, dds_type
from surg_ros2.cdr import Codec, Malformed
from surg_ros2.message_types_node import codec, message_class
from surg_ros2.ros2_caller_node import LARGEST, Caller, forked

NAMELESS = 3.0
"""[s] How long a process may be without the name of a ROS 2 node before it gets one."""
EARLY = 4.0
"""[s] How long a command waits for the node of its sender; in lock-step without end."""
MOST_EARLY = 1000
"""Commands that wait so."""
MOST_CALLERS = 32
"""ROS 2 processes that may send commands at a time."""


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
            self._readers[topic] = (kind, reader, codec(message_class(kind)))

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
        elif (self._blocking or now - came < EARLY) and len(self._early) < MOST_EARLY:
            self._early.append((came, handle, topic, sample))
        else:
            self._warn(topic, "a command whose sender did not make itself known was dropped")
