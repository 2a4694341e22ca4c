"""The gateway between a ROS 1 graph and processes that speak DDS as ROS 2 does."""

from __future__ import annotations

import itertools
import random
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import rospy
from geometry_msgs.msg import PoseStamped

from crtk_msgs.msg import OperatingState
from crtk_msgs.srv import QueryInverseKinematics
from crtk_msgs.srv import QueryInverseKinematicsRequest as Request
from crtk_msgs.srv import QueryInverseKinematicsResponse as Response
from helpers.graph.crtk_client import Arm, WallTime
from helpers.graph.ros import RosGraph
from helpers.results.ros2_results import note
from helpers.ros2 import drawn_messages as drawn
from surg_cli.graph import master, topic_contract
from surg_cli.graph.processes import Child
from surg_cli.host import paths
from surg_msgs.msg import Cycle

pytest.importorskip("cyclonedds", reason="missing: ./surg dev setup --all installs cyclonedds")
pytestmark = [pytest.mark.ros]

PEER = paths.ROOT / "tests" / "helpers" / "ros2" / "peer.py"
CLIENT = PEER.with_name("cyclone_client.py")
SERVICE = "/PSM1/inverse_kinematics"
WAIT_S = 90.0
DOMAINS = range(150, 230)
"""Of DDS; ROS 2 users take lower ones."""
POSE = "geometry_msgs/PoseStamped"
JUNK = "00010000ffffffff"
KILLED, TOGETHER = 200, 4
"""Processes that are killed, and how many at a time."""
DRIVERS = 20
"""Processes that drive an arm and are killed, one after another."""
HOLD_S = 0.15
"""[s] `servo_timeout`, and what a busy machine adds."""
GROWTH_MB = 30.0
"""More than that is no noise of the allocator."""


@pytest.fixture
def domain() -> int:
    return random.SystemRandom().choice(DOMAINS)


@pytest.fixture
def gateway(ros_graph: RosGraph, domain: int) -> Callable[..., Child]:
    def start(name: str = "/ros2", **more: object) -> Child:
        params = {"contract": topic_contract.SOURCE, "domain": domain, "commands": True, **more}
        return ros_graph.node("surg_ros2", "ros2_gateway_node.py", name, params)

    return start


class Graph:
    """The ROS 1 side: an arm that publishes two topics and hears one."""

    def __init__(self, rng: random.Random) -> None:
        self.pose = drawn.draw(POSE, rng)
        self.state = drawn.draw("crtk_msgs/OperatingState", rng)
        self.heard: dict[str, set[bytes]] = {}
        self.times: dict[str, list[float]] = {}
        state = rospy.Publisher("/PSM1/operating_state", OperatingState, latch=True, queue_size=1)
        state.publish(self.state)
        self.stream = rospy.Publisher("/PSM1/measured_cp", PoseStamped, queue_size=10)
        self.ear = rospy.Subscriber("/PSM1/servo_cp", PoseStamped, self._hear)

    def _hear(self, message: Any) -> None:
        caller = message._connection_header["callerid"]
        self.heard.setdefault(caller, set()).add(drawn.packed(drawn.without_seq(message)))
        self.times.setdefault(caller, []).append(time.monotonic())

    def gap(self, caller: str) -> float:
        """Longest time between two commands of a sender [s]."""
        times = self.times[caller]
        return max((b - a for a, b in itertools.pairwise(times)), default=0.0)


def peer(
    graph: RosGraph,
    domain: int,
    name: str,
    data: str,
    *hear: str,
    label: str = "",
    period: float = 0.05,
    copies: int = 1,
) -> Child:
    words = [sys.executable, PEER, domain, name, "/PSM1/servo_cp", POSE, period, data, *hear]
    env = {"PEER_COPIES": str(copies)}
    return graph.supervisor.start(
        f"peer{label or name}", [str(word) for word in words], extra_env=env
    )


def test_both_ways_with_an_authority_of_its_own_for_each_process(
    ros_graph: RosGraph,
    rospy_node: str,
    domain: int,
    gateway: Callable[..., Child],
    rng: random.Random,
) -> None:
    graph, command = Graph(rng), drawn.draw(POSE, rng)
    node = gateway()
    data = drawn.cdr(POSE, command).hex()
    hear = [f"/PSM1/measured_cp={POSE}", "/PSM1/operating_state!=crtk_msgs/OperatingState"]
    first = peer(ros_graph, domain, "script", data, *hear, label="1")
    second = peer(ros_graph, domain, "script", data, label="2")
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

    assert len(udp_sockets(node)) > 2
    assert [
        each for each in udp_sockets(node) if not each.startswith(("127.", "0.0.0.0%lo:"))
    ] == []
    ros_graph.supervisor.stop([second])
    ros_graph.wait_for(
        lambda: len(names & set(master.nodes(ros_graph.uri))) == 1, WAIT_S, "its node to end"
    )
    assert node.exit_code is None


def test_junk_and_wrong_types_do_no_harm_and_a_second_gateway_gives_way(
    ros_graph: RosGraph,
    rospy_node: str,
    domain: int,
    gateway: Callable[..., Child],
    rng: random.Random,
) -> None:
    graph, command = Graph(rng), drawn.draw(POSE, rng)
    node = gateway()
    peer(ros_graph, domain, "junk", JUNK)
    peer(ros_graph, domain, "", drawn.cdr(POSE, command).hex(), label="good")
    ros_graph.wait_for(lambda: bool(graph.heard), WAIT_S, "a good command")
    (name,) = graph.heard
    assert name.startswith("/ros2_peer_")
    other = gateway("/another")
    ros_graph.wait_for(lambda: other.exit_code is not None, WAIT_S, "the second gateway's end")
    assert other.exit_code == 2
    assert "another gateway runs in this ROS 2 domain" in other.log_tail()
    said = "from ros2_junk: geometry_msgs/PoseStamped: 8 bytes do not fit"
    ros_graph.wait_for(lambda: said in node.log_tail(100), WAIT_S, "the junk's refusal")
    assert node.exit_code is None


def test_a_service_is_asked_as_rmw_cyclonedds_frames_it(
    ros_graph: RosGraph,
    rospy_node: str,
    domain: int,
    gateway: Callable[..., Child],
    rng: random.Random,
) -> None:
    kind = "crtk_msgs/QueryInverseKinematics"
    request, reply = (drawn.filled(half, rng) for half in (Request, Response))
    asked: list[Any] = []
    server = rospy.Service(SERVICE, QueryInverseKinematics, lambda q: asked.append(q) or reply)
    gateway(implementation="rmw_cyclonedds_cpp")
    data = drawn.cdr(kind, request)[4:].hex()
    words = [sys.executable, CLIENT, domain, SERVICE, kind, data]
    client = ros_graph.supervisor.start("client", [str(word) for word in words])
    ros_graph.wait_for(lambda: len(client.log_tail(9).split()) > 3, WAIT_S, "two replies")
    server.shutdown()
    assert {drawn.packed(each) for each in asked} == {drawn.packed(request)}
    answers = dict(line.split() for line in client.log.read_text().splitlines())
    assert set(answers.values()) == {padded(drawn.cdr(kind, reply)[4:]).hex()}


def padded(data: bytes) -> bytes:
    """As DDS sends it: a multiple of four bytes."""
    return data + bytes(-len(data) % 4)


def udp_sockets(child: Child) -> list[str]:
    """Where the UDP sockets of a process are open, as `address%interface:port`."""
    listed = subprocess.run(["ss", "-Hunap"], capture_output=True, text=True, check=True).stdout
    lines = [line for line in listed.splitlines() if f"pid={child.process.pid}," in line]
    return [line.split()[3] for line in lines]


@pytest.mark.full
def test_killed_processes_leave_nothing_and_cross_nobodys_authority(
    ros_graph: RosGraph,
    rospy_node: str,
    domain: int,
    gateway: Callable[..., Child],
    rng: random.Random,
) -> None:
    graph, node = Graph(rng), gateway()
    commands = [drawn.draw(POSE, rng) for _ in range(2)]
    same = [{drawn.packed(drawn.without_seq(each))} for each in commands]
    good, dying = (drawn.cdr(POSE, each).hex() for each in commands)
    peer(ros_graph, domain, "good", good)
    ros_graph.wait_for(lambda: "/ros2_good" in graph.heard, WAIT_S, "the good one")
    sizes = []
    for k in range(KILLED // TOGETHER):
        more = peer(ros_graph, domain, "dies", dying, label=str(k), copies=TOGETHER)
        ros_graph.wait_for(
            lambda m=more: m.log_tail(99).count("ready") == TOGETHER, WAIT_S, "peers"
        )
        more.send(signal.SIGKILL)
        sizes.append(resident(node))
    ros_graph.wait_for(
        lambda: not [n for n in master.nodes(ros_graph.uri) if n.startswith("/ros2_dies")],
        WAIT_S,
        "the nodes of the killed to end",
    )
    gap = graph.gap("/ros2_good")
    memory = f"memory {sizes[0]:.0f} to {sizes[-1]:.0f} MB"
    note("killed senders", KILLED, f"longest pause of another sender {gap:.2f} s; {memory}")
    assert graph.heard.pop("/ros2_good") == same[0]
    assert all(messages == same[1] for messages in graph.heard.values())
    assert sizes[-1] < sizes[0] + GROWTH_MB
    assert node.exit_code is None


@pytest.mark.full
def test_the_arm_holds_when_its_driver_is_killed(
    ros_graph: RosGraph, rospy_node: str, domain: int, gateway: Callable[..., Child]
) -> None:
    shared: dict[str, object] = {"cell": paths.ROOT / "cells" / "sim_ur5e", "mode": "freerun"}
    ros_graph.node("surg_sim", "bridge_node.py", "/sim", shared)
    ros_graph.node("surg_control", "rcm_node", "/PSM1/controller", {**shared, "arm": "PSM1"})
    node, cycles = gateway(), list[Cycle]()
    ear = rospy.Subscriber("/PSM1/cycle", Cycle, cycles.append, queue_size=None)
    arm, held = Arm("PSM1", WallTime()), []

    def at_home() -> bool:
        return arm.enable(2.0) and arm.home(2.0)

    def driven() -> bool:
        if cycles[-1].state == Cycle.FAULT:  # it got no processor for some time
            at_home()
        return bool(cycles[-1].command == Cycle.SERVO_CP)

    try:
        arm.check_connections(WAIT_S)
        ros_graph.wait_for(at_home, WAIT_S, "home")
        stay = drawn.cdr(POSE, PoseStamped(pose=arm.get("setpoint_cp", 1.0, 1.0).pose)).hex()
        for k in range(DRIVERS):
            driver = peer(ros_graph, domain, "drives", stay, label=str(k), period=0.01)
            ros_graph.wait_for(driven, WAIT_S, f"driver {k}")
            assert cycles[-1].source.startswith("/ros2_drives")
            driver.send(signal.SIGKILL)
            ros_graph.wait_for(
                lambda: cycles[-1].command != Cycle.SERVO_CP, WAIT_S, "the arm to hold"
            )
            if cycles[-1].state == Cycle.ENABLED:
                held.append(silence(list(cycles)))
    finally:
        arm.close()
        ear.unregister()
    note(
        "drivers killed", len(held), f"silent {1e3 * max(held):.0f} ms at most until the arm holds"
    )
    assert len(held) > DRIVERS // 2 and max(held) < HOLD_S
    assert node.exit_code is None


def silence(cycles: list[Cycle]) -> float:
    """From the last command that was obeyed to the last cycle that waited for another [s]."""
    last = max(k for k, cycle in enumerate(cycles) if cycle.command == Cycle.SERVO_CP)
    obeyed = max(k for k in range(1, last + 1) if cycles[k].accepted > cycles[k - 1].accepted)
    return float((cycles[last].header.stamp - cycles[obeyed].header.stamp).to_sec())


def resident(child: Child) -> float:
    """Memory of a process [MB]."""
    pages = int(Path(f"/proc/{child.process.pid}/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


@pytest.mark.parametrize(
    ("params", "said"),
    [
        ({"interface": "nope"}, "no network interface 'nope'; there are lo"),
        ({"domain": 233}, "~domain is 233; allowed: a whole number from 0 to 232"),
        ({"contract": "/nowhere.yaml"}, "/nowhere.yaml: no contract of topics"),
    ],
)
def test_a_gateway_that_cannot_run_says_why(
    ros_graph: RosGraph, gateway: Callable[..., Child], params: dict[str, object], said: str
) -> None:
    node = gateway(**params)
    ros_graph.wait_for(lambda: node.exit_code is not None, WAIT_S, "its end")
    assert (node.exit_code, said in node.log_tail()) == (2, True), node.log_tail()
