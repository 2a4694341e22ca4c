"""The gateway between a ROS 1 graph and processes that speak DDS as ROS 2 does."""

from __future__ import annotations

import random
import sys
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
from helpers.ros2.dds_peers import POSE, Dds, udp_sockets
from surg_cli.graph import master
from surg_cli.host import paths

pytest.importorskip("cyclonedds", reason="missing: ./surg dev setup --all installs cyclonedds")
pytestmark = [pytest.mark.ros]

CLIENT = paths.ROOT / "tests" / "helpers" / "ros2" / "cyclone_client.py"
SERVICE = "/PSM1/inverse_kinematics"
WAIT_S = 90.0
JUNK = "00010000ffffffff"


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


def test_junk_and_wrong_types_do_no_harm_and_a_second_gateway_gives_way(
    ros_graph: RosGraph,
    rospy_node: str,
    dds: Dds,
    rng: random.Random,
) -> None:
    graph, command = Graph(rng), drawn.draw(POSE, rng)
    node = dds.gateway()
    dds.peer("junk", JUNK)
    dds.peer("", drawn.cdr(POSE, command).hex(), label="good")
    ros_graph.wait_for(lambda: bool(graph.heard), WAIT_S, "a good command")
    (name,) = graph.heard
    assert name.startswith("/ros2_peer_")
    other = dds.gateway("/another")
    ros_graph.wait_for(lambda: other.exit_code is not None, WAIT_S, "the second gateway's end")
    assert other.exit_code == 2
    assert "another gateway runs in this ROS 2 domain" in other.log_tail()
    said = "from ros2_junk: geometry_msgs/PoseStamped: 8 bytes do not fit"
    ros_graph.wait_for(lambda: said in node.log_tail(100), WAIT_S, "the junk's refusal")
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
