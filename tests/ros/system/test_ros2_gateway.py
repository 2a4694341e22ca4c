"""The gateway between a ROS 1 graph and processes that speak DDS as ROS 2 does."""

from __future__ import annotations

import random
import sys
from pathlib import Path
from typing import Any

import pytest
import rospy
from geometry_msgs.msg import PoseStamped

from crtk_msgs.msg import OperatingState
from crtk_msgs.srv import QueryInverseKinematics
from crtk_msgs.srv import QueryInverseKinematicsRequest as Request
from crtk_msgs.srv import QueryInverseKinematicsResponse as Response
from helpers.graph.ros import RosGraph
from helpers.ros2 import drawn_messages as drawn
from helpers.ros2 import keystore
from helpers.ros2.dds_peers import POSE, Dds, udp_sockets
from surg_cli.graph import master
from surg_cli.host import paths

pytest.importorskip("cyclonedds", reason="missing: ./surg dev setup --all installs cyclonedds")
pytestmark = [pytest.mark.ros, pytest.mark.untimed]

CLIENT = paths.ROOT / "tests" / "helpers" / "ros2" / "cyclone_client.py"
SERVICE = "/PSM1/inverse_kinematics"
WAIT_S = 90.0
JUNK = "00010000ffffffff"
TWIST = "geometry_msgs/TwistStamped"
MORE = bytes(8).hex()
"""A field behind those that we know."""


@pytest.fixture
def dds(ros_graph: RosGraph) -> Dds:
    return Dds(ros_graph)


class Graph:
    """The ROS 1 side: an arm that publishes two topics and hears one."""

    def __init__(self, rng: random.Random) -> None:
        self.pose = drawn.draw(POSE, rng)
        self.state = drawn.draw("crtk_msgs/OperatingState", rng)
        self.heard: dict[str, set[bytes]] = {}
        state = rospy.Publisher("/PSM1/operating_state", OperatingState, latch=True, queue_size=1)
        state.publish(self.state)
        self.stream = rospy.Publisher("/PSM1/measured_cp", PoseStamped, queue_size=10)
        self.ear = rospy.Subscriber("/PSM1/servo_cp", PoseStamped, self._hear)

    def _hear(self, message: Any) -> None:
        caller = message._connection_header["callerid"]
        self.heard.setdefault(caller, set()).add(drawn.packed(drawn.without_seq(message)))


def test_both_ways_with_an_authority_of_its_own_for_each_process(
    ros_graph: RosGraph,
    rospy_node: str,
    dds: Dds,
    rng: random.Random,
) -> None:
    graph, command = Graph(rng), drawn.draw(POSE, rng)
    node = dds.gateway()
    data = drawn.cdr(POSE, command).hex()
    hear = [f"/PSM1/measured_cp={POSE}", "/PSM1/operating_state!=crtk_msgs/OperatingState"]
    first = dds.peer("script", data, *hear, label="1")
    second = dds.peer("script", data, label="2")
    names = {"/ros2_script", "/ros2_script_2"}
    ros_graph.wait_for(lambda: set(graph.heard) == names, WAIT_S, "two senders with names")
    same = {drawn.packed(drawn.without_seq(command))}
    assert all(messages == same for messages in graph.heard.values())

    def heard(topic: str, message: Any) -> bool:
        graph.stream.publish(graph.pose)
        kind = message._type
        return f"{topic} {drawn.cdr(kind, message).hex()}" in first.log_tail(1000)

    for topic, message in (
        ("/PSM1/operating_state", graph.state),
        ("/PSM1/measured_cp", graph.pose),
    ):
        ros_graph.wait_for(lambda t=topic, m=message: heard(t, m), WAIT_S, topic)

    assert len(udp_sockets(node.process.pid)) > 2
    assert [
        each
        for each in udp_sockets(node.process.pid)
        if not each.startswith(("127.", "0.0.0.0%lo:"))
    ] == []
    ros_graph.supervisor.stop([second])
    ros_graph.wait_for(
        lambda: len(names & set(master.nodes(ros_graph.uri))) == 1, WAIT_S, "its node to end"
    )
    assert node.exit_code is None


def test_what_is_foreign_is_named_and_reaches_nobody_and_a_second_gateway_gives_way(
    ros_graph: RosGraph,
    rospy_node: str,
    dds: Dds,
    rng: random.Random,
) -> None:
    """Junk, another type, another definition and another domain, beside a good command."""
    graph = Graph(rng)
    pose, twist = (drawn.cdr(kind, drawn.draw(kind, rng)).hex() for kind in (POSE, TWIST))
    node = dds.gateway()
    dds.peer("junk", JUNK)
    dds.peer("type", twist, kind=TWIST)
    dds.peer("definition", pose + MORE)
    away = dds.peer("away", pose, domain=dds.domain + 1)
    ros_graph.wait_for(lambda: "ready" in away.log_tail(), WAIT_S, "the one that is away")
    for said in (
        "from ros2_junk: geometry_msgs/PoseStamped: 8 bytes do not fit",
        f"a ROS 2 node sends geometry_msgs::msg::dds_::TwistStamped_; expected {POSE}",
        "its package has another definition: build it from this workspace's",
    ):
        ros_graph.wait_for(lambda s=said: s in node.log_tail(100), WAIT_S, said)
    dds.peer("", pose, label="good")
    ros_graph.wait_for(lambda: bool(graph.heard), WAIT_S, "a good command")
    (name,) = graph.heard
    assert name.startswith("/ros2_peer_")
    other = dds.gateway("/another")
    ros_graph.wait_for(lambda: other.exit_code is not None, WAIT_S, "the second gateway's end")
    assert other.exit_code == 2
    assert "another gateway runs in this ROS 2 domain" in other.log_tail()
    assert node.exit_code is None


def test_a_service_is_asked_as_rmw_cyclonedds_frames_it(
    ros_graph: RosGraph,
    rospy_node: str,
    dds: Dds,
    rng: random.Random,
) -> None:
    kind = "crtk_msgs/QueryInverseKinematics"
    request, reply = (drawn.filled(half, rng) for half in (Request, Response))
    asked: list[Any] = []
    server = rospy.Service(SERVICE, QueryInverseKinematics, lambda q: asked.append(q) or reply)
    dds.gateway(implementation="rmw_cyclonedds_cpp")
    data = drawn.cdr(kind, request)[4:].hex()
    words = [sys.executable, CLIENT, dds.domain, SERVICE, kind, data]
    client = ros_graph.supervisor.start("client", [str(word) for word in words])
    ros_graph.wait_for(lambda: len(client.log_tail(9).split()) > 3, WAIT_S, "two replies")
    server.shutdown()
    assert {drawn.packed(each) for each in asked} == {drawn.packed(request)}
    answers = dict(line.split() for line in client.log.read_text().splitlines())
    assert set(answers.values()) == {padded(drawn.cdr(kind, reply)[4:]).hex()}


def padded(data: bytes) -> bytes:
    """As DDS sends it: a multiple of four bytes."""
    return data + bytes(-len(data) % 4)


@pytest.mark.parametrize(
    ("params", "missing", "said"),
    [
        ({"interface": "nope"}, "", "no network interface 'nope'; there are lo"),
        ({}, "cyclonedds", "cyclonedds"),
    ],
)
def test_a_gateway_that_cannot_run_says_why(
    ros_graph: RosGraph,
    dds: Dds,
    tmp_path: Path,
    params: dict[str, object],
    missing: str,
    said: str,
) -> None:
    (tmp_path / "sitecustomize.py").write_text(f"import sys\nsys.modules[{missing!r}] = None\n")
    env = {"PYTHONPATH": f"{tmp_path}:{ros_graph.env.get('PYTHONPATH', '')}"}
    node = dds.gateway(env=env, **params)
    ros_graph.wait_for(lambda: node.exit_code is not None, WAIT_S, "its end")
    cure = "./surg up CELL --ros2 installs it" if missing else ""
    last = node.log_tail(1)
    assert (node.exit_code, said in last, cure in last) == (2, True, True), node.log_tail()


def test_without_the_means_of_dds_security_it_ends(
    ros_graph: RosGraph, dds: Dds, tmp_path: Path
) -> None:
    """The libddsc of PyPI has none, and no plug-ins are there for another one."""
    enclave = keystore.enclave(keystore.authority(tmp_path / "keys"), "/gateway")
    node = dds.gateway(enclave=enclave)
    ros_graph.wait_for(lambda: node.exit_code is not None, WAIT_S, "its end")
    assert node.exit_code == 2
    assert "DDS Security needs a libddsc with it (PyPI's has none)" in node.log_tail(1)
    assert "libdds_security_auth.so" in node.log_tail(1)
