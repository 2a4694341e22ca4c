"""Who is connected to a node: lock-step may only start when nothing can get lost.

Asks the ROS master and the node itself over XML-RPC, the only public place where a Python node's
peers have names. No ROS import: two URIs in, names out.
"""

from __future__ import annotations

import xmlrpc.client
from collections.abc import Iterable
from typing import Any


def subscribers(node_uri: str, name: str, topics: Iterable[str]) -> dict[str, set[str]]:
    """Caller ids of the nodes that are connected to a node's publishers, by resolved topic.

    Raises:
        OSError: The node does not answer.
    """
    callers: dict[str, set[str]] = {topic: set() for topic in topics}
    with xmlrpc.client.ServerProxy(node_uri) as node:
        connections: Any = node.getBusInfo(name)
    for _, peer, direction, _, topic, connected, *_ in connections[2]:
        if direction == "o" and connected and topic in callers:
            callers[topic].add(str(peer))
    return callers


def publishers(master_uri: str, name: str, topic: str) -> set[str]:
    """Caller ids of the nodes that have told the master that they publish a resolved topic.

    Raises:
        OSError: The master does not answer.
    """
    with xmlrpc.client.ServerProxy(master_uri) as master:
        state: Any = master.getSystemState(name)
    return {str(node) for known, nodes in state[2][0] if known == topic for node in nodes}
