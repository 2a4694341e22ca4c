"""What a running ROS graph offers: topics and services with type, md5, direction, latching.

Asks the master, and each publisher and service by the first words of ROS's own TCP protocol. No
rospy: nothing is subscribed, nobody's queue fills.
"""

from __future__ import annotations

import socket
import struct
import xmlrpc.client
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlparse

from surg_cli.graph import master

CALLER = "/surg_cli"
_PATIENCE = 5.0  # [s]


@dataclass(frozen=True)
class Seen:
    """One topic at one node, or one service.

    Attributes:
        name: Resolved name.
        node: Caller id of the node.
        direction: `in`, `out` or `service`, seen from the node.
        type: ROS type.
        md5: What the node itself says; empty for `in`, where only a sender could ask.
        latched: Whether a late subscriber is sent the last message.
    """

    name: str
    node: str
    direction: str
    type: str
    md5: str = ""
    latched: bool = False


def observe(uri: str) -> list[Seen]:
    """Everything that the graph offers, sorted by name.

    Args:
        uri: ROS_MASTER_URI.

    Raises:
        Problem: No master answers there.
        OSError: A node does not answer.
    """
    publishers, subscribers, services = master.call(uri, "getSystemState")
    types = dict(master.call(uri, "getTopicTypes"))
    seen = [
        Seen(topic, node, "in", types.get(topic, "*"))
        for topic, nodes in subscribers
        for node in nodes
    ]
    for topic, nodes in publishers:
        for node in nodes:
            words = _publisher_words(master.call(uri, "lookupNode", node), topic)
            latched = words.get("latching", "0") == "1"
            seen.append(Seen(topic, node, "out", words["type"], words["md5sum"], latched))
    for service, nodes in services:
        place = urlparse(master.call(uri, "lookupService", service))
        assert place.hostname is not None and place.port is not None
        asked = {"service": service, "md5sum": "*", "probe": "1"}
        link, words = _greet(place.hostname, place.port, asked)
        link.close()
        seen += [Seen(service, node, "service", words["type"], words["md5sum"]) for node in nodes]
    return sorted(seen, key=lambda s: (s.name, s.node, s.direction))


def _publisher_words(node_uri: str, topic: str) -> dict[str, str]:
    link, words = connect(node_uri, topic)
    link.close()
    return words


def connect(node_uri: str, topic: str) -> tuple[socket.socket, dict[str, str]]:
    """Connect to a topic as a subscriber of any type.

    Args:
        node_uri: Of the publisher.
        topic: Resolved name.

    Returns:
        The connection, on which the messages will come, and what the publisher says of itself.

    Raises:
        OSError: The node does not answer, or refuses.
    """
    with xmlrpc.client.ServerProxy(node_uri) as node:
        answer: Any = node.requestTopic(CALLER, topic, [["TCPROS"]])
    code, text, where = answer
    if code != 1:
        raise OSError(f"{node_uri} refuses {topic}: {text}")
    return _greet(where[1], where[2], {"topic": topic, "md5sum": "*", "type": "*"})


def _greet(host: str, port: int, words: dict[str, str]) -> tuple[socket.socket, dict[str, str]]:
    """Connect and send one connection header; the connection and the other side's header."""
    fields = [f"{key}={value}".encode() for key, value in {"callerid": CALLER, **words}.items()]
    header = b"".join(struct.pack("<I", len(field)) + field for field in fields)
    link = socket.create_connection((host, port), timeout=_PATIENCE)
    try:
        link.sendall(struct.pack("<I", len(header)) + header)
        (length,) = struct.unpack("<I", _read(link, 4))
        return link, _words(_read(link, length))
    except BaseException:
        link.close()
        raise


def _words(data: bytes) -> dict[str, str]:
    answer, at = {}, 0
    while at < len(data):
        (size,) = struct.unpack_from("<I", data, at)
        key, _, value = data[at + 4 : at + 4 + size].decode().partition("=")
        answer[key] = value
        at += 4 + size
    return answer


def _read(link: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count:
        more = link.recv(count - len(data))
        if not more:
            raise OSError(f"the connection ended after {len(data)} of {count} bytes")
        data += more
    return data
