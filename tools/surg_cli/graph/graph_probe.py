"""What a running ROS graph offers: topics and services with type, md5, direction, latching.

Asks the master, and each publisher and service by the connection header of ROS's TCP protocol. No
rospy: nothing is subscribed, so nobody's queue fills.
"""

from __future__ import annotations

import io
import socket
import xmlrpc.client
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlparse

from rosgraph.network import (
    ROSHandshakeException,
    encode_ros_handshake_header,
    read_ros_handshake_header,
)

from surg_cli.graph import master

CALLER = "/surg_cli"
TIMEOUT_S = 5.0


@dataclass(frozen=True)
class GraphEnd:
    """One topic at one node, or one service.

    ``direction`` is `in`, `out` or `service`, seen from the node; ``md5`` is what the node itself
    states, empty for `in`, where only a sender could ask.
    """

    name: str
    node: str
    direction: str
    type: str
    md5: str = ""
    latched: bool = False


def observe(uri: str) -> list[GraphEnd]:
    """Everything that the graph of a master offers, sorted by name.

    Raises:
        CliError: No master answers there.
        OSError: A node does not answer.
    """
    publishers, subscribers, services = master.call(uri, "getSystemState")
    types = dict(master.call(uri, "getTopicTypes"))
    seen = [
        GraphEnd(topic, node, "in", types.get(topic, "*"))
        for topic, nodes in subscribers
        for node in nodes
    ]
    for topic, nodes in publishers:
        for node in nodes:
            link, words = connect(master.call(uri, "lookupNode", node), topic)
            link.close()
            latched = words.get("latching", "0") == "1"
            seen.append(GraphEnd(topic, node, "out", words["type"], words["md5sum"], latched))
    for service, nodes in services:
        place = urlparse(master.call(uri, "lookupService", service))
        assert place.hostname is not None and place.port is not None
        asked = {"service": service, "md5sum": "*", "probe": "1"}
        link, words = _greet(place.hostname, place.port, asked)
        link.close()
        seen += [
            GraphEnd(service, node, "service", words["type"], words["md5sum"]) for node in nodes
        ]
    return sorted(seen, key=lambda s: (s.name, s.node, s.direction))


def connect(node_uri: str, topic: str) -> tuple[socket.socket, dict[str, str]]:
    """Connect to a topic as a subscriber of any type.

    Returns the connection, on which the messages will come, and the publisher's header.

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
    link = socket.create_connection((host, port), timeout=TIMEOUT_S)
    try:
        link.sendall(encode_ros_handshake_header({"callerid": CALLER, **words}))
        return link, read_ros_handshake_header(link, io.BytesIO(), 4096)
    except ROSHandshakeException as error:
        link.close()
        raise OSError(str(error)) from error
    except BaseException:
        link.close()
        raise
