"""The comparison of contract and graph must notice what it is there for; no ROS."""

from __future__ import annotations

import itertools
from dataclasses import replace

import pytest

from surg_cli.graph.graph_probe import GraphEnd
from surg_cli.graph.topic_contract import PAGE, REFERENCE, SOURCE, Contract, compare, load, render

NODES = ("controller", "sim")


@pytest.fixture
def contract() -> Contract:
    return load()


@pytest.fixture
def graph(contract: Contract) -> list[GraphEnd]:
    """A graph that is the contract, in free-run."""
    return [
        GraphEnd(
            name=entry.resolved("PSM1"),
            node=f"/PSM1/{entry.node}",
            direction=entry.direction,
            type=entry.type,
            md5="" if entry.direction == "in" else contract.types.get(entry.type, "own"),
            latched=entry.direction == "out" and entry.latched[1],
        )
        for entry in contract.entries
        if entry.node in NODES and entry.only in {None, *REFERENCE}
    ]


def wrong(contract: Contract, graph: list[GraphEnd]) -> list[str]:
    return compare(contract, graph, "PSM1", NODES, lockstep=False)


def test_what_is_promised_is_no_difference(contract: Contract, graph: list[GraphEnd]) -> None:
    assert wrong(contract, graph) == []
    assert len(graph) > 50


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("/PSM1/servo_cp", {"type": "geometry_msgs/Pose"}, "type geometry_msgs/Pose, promised"),
        ("/PSM1/measured_cp", {"md5": "0" * 32}, "md5 000"),
        ("/PSM1/operating_state", {"latched": False}, "latched False"),
        ("/PSM1/measured_js", {"latched": True}, "latched True"),
        ("/PSM1/forward_kinematics", {"md5": "1" * 32}, "md5 111"),
    ],
)
def test_a_difference_is_named(
    contract: Contract, graph: list[GraphEnd], name: str, change: dict, words: str
) -> None:
    index = next(i for i, seen in enumerate(graph) if seen.name == name)
    graph[index] = replace(graph[index], **change)
    (sentence,) = wrong(contract, graph)
    assert sentence.startswith(f"{name}: {words}")


def test_a_topic_too_few_or_too_many_is_named(contract: Contract, graph: list[GraphEnd]) -> None:
    graph.remove(next(seen for seen in graph if seen.name == "/PSM1/move_jp"))
    graph.append(GraphEnd("/PSM1/free", "/PSM1/controller", "in", "std_msgs/Empty"))
    sentences = wrong(contract, graph)
    assert [s for s in sentences if "/PSM1/free" in s and "not in topics.yaml" in s]
    assert [s for s in sentences if "/PSM1/move_jp" in s and "not on the graph" in s]
    assert len(sentences) == 2


def test_the_page_is_that_of_the_contract(contract: Contract) -> None:
    assert PAGE.read_text("utf-8") == render(contract)


def test_nobody_offers_a_topic_twice(contract: Contract) -> None:
    """The compatibility node must not shadow a topic of the controller.

    The two leader nodes offer the same: one of them has a leader's name. So do simulator and link
    with drive: an arm has one of them. In real time the simulator leaves an arm's forces to its
    sensor.
    """
    robots = (("link", "force", "drive"), ("sim",))
    for leader, robot in itertools.product(("leader", "lambda7"), robots):
        entries = [entry for entry in contract.entries if entry.node not in (leader, *robot)]
        # Anybody warns, each node states its own frames; teleoperation and drive listen to others.
        own = [e for e in entries if e.name not in ("<arm>/warning", "/tf_static")]
        own = [e for e in own if e.node not in ("teleop", "drive") or e.direction != "in"]
        ends = [(e.name, e.direction) for e in own]
        assert sorted(ends) == sorted(set(ends))


def test_a_contract_that_cannot_be_read_is_refused(tmp_path) -> None:
    text = SOURCE.read_text("utf-8")
    for old, new in (("dir: in", "direction: in"), ("std_msgs/Empty,", "std_msgs/Emptiness,")):
        broken = tmp_path / "topics.yaml"
        broken.write_text(text.replace(old, new, 1))
        with pytest.raises(ValueError, match="unknown"):
            load(broken)


def test_a_topic_of_a_task_is_promised_with_a_task_only(
    contract: Contract, graph: list[GraphEnd]
) -> None:
    of_task = [e for e in contract.entries if e.only == "task"]
    assert len(of_task) >= 5
    assert wrong(contract, graph) == []
    with_task = compare(contract, graph, "PSM1", NODES, False, parameters={"task", *REFERENCE})
    assert len(with_task) == len(of_task)
    assert all("promised and not on the graph" in sentence for sentence in with_task)
