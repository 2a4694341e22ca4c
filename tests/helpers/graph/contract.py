"""The topics of one node: what topics.yaml promises, and what a running graph has."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from helpers.graph.ros import RosGraph
from surg_cli.graph import master, topic_contract

Topics = set[tuple[str, str, str]]
"""Topic, type, and `in` or `out`."""


def promised(
    node: str, leader: str, arms: Iterable[str] = ("",), parameters: Collection[str] = ()
) -> Topics:
    """What the contract promises of a node.

    Args:
        node: Base name.
        leader: For `<leader>`.
        arms: For `<arm>`; every row is there for each.
        parameters: Optional ones that are on.
    """
    names = list(arms)
    return {
        (entry.name.replace("<leader>", leader).replace("<arm>", arm), entry.type, entry.direction)
        for entry in topic_contract.load().entries
        if entry.node == node and (entry.only is None or entry.only in parameters)
        for arm in names
    }


def found(graph: RosGraph, node: str, without: tuple[str, ...] = ()) -> Topics:
    """What a node has on the running graph.

    Args:
        graph: The graph.
        node: Its absolute name.
        without: Beginnings of the names of topics that are others', or ROS's own.
    """
    publications, subscriptions, _ = master.call(graph.uri, "getSystemState")
    types = dict(master.call(graph.uri, "getTopicTypes"))
    return {
        (topic, types[topic], way)
        for table, way in ((publications, "out"), (subscriptions, "in"))
        for topic, nodes in table
        if node in nodes and not topic.startswith((*without, "/rosout", "/clock"))
    }
