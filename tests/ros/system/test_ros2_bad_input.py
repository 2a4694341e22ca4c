"""What may be wrong on the way to ROS 2 is said, with a cure, and does no harm."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest
import rospy
from geometry_msgs.msg import PoseStamped

from helpers.graph.ros import RosGraph
from helpers.ros2 import drawn_messages as drawn
from helpers.ros2 import keystore
from helpers.ros2.dds_peers import COMMAND, POSE, Dds

pytest.importorskip("cyclonedds", reason="missing: ./surg dev setup --all installs cyclonedds")
pytestmark = pytest.mark.ros

WAIT_S = 90.0
TWIST = "geometry_msgs/TwistStamped"
MORE = bytes(8)
"""A field behind those that we know."""


class Heard:
    """Senders whose commands have reached the graph."""

    def __init__(self) -> None:
        self.senders: set[str] = set()
        self.ear = rospy.Subscriber(COMMAND, PoseStamped, self._hear)

    def _hear(self, message: Any) -> None:
        self.senders.add(message._connection_header["callerid"])


@pytest.mark.parametrize(
    ("kind", "more", "said"),
    [
        (
            TWIST,
            b"",
            f"a ROS 2 node sends geometry_msgs::msg::dds_::TwistStamped_; expected {POSE}",
        ),
        (POSE, MORE, "its package has another definition: build it from this workspace's"),
    ],
    ids=["another type", "another definition"],
)
def test_foreign_messages_are_named_and_reach_nobody(
    ros_graph: RosGraph, rospy_node: str, rng: random.Random, kind: str, more: bytes, said: str
) -> None:
    heard, dds = Heard(), Dds(ros_graph)
    node = dds.gateway()
    good, foreign = (drawn.cdr(each, drawn.draw(each, rng)) for each in (POSE, kind))
    dds.peer("foreign", (foreign + more).hex(), kind=kind)
    ros_graph.wait_for(lambda: said in node.log_tail(100), WAIT_S, said)
    dds.peer("good", good.hex())
    ros_graph.wait_for(lambda: bool(heard.senders), WAIT_S, "a good one")
    assert heard.senders == {"/ros2_good"}
    assert node.exit_code is None


def test_another_domain_is_not_heard(
    ros_graph: RosGraph, rospy_node: str, rng: random.Random
) -> None:
    heard, dds = Heard(), Dds(ros_graph)
    dds.gateway()
    pose = drawn.cdr(POSE, drawn.draw(POSE, rng)).hex()
    away = dds.peer("away", pose, domain=dds.domain + 1)
    ros_graph.wait_for(lambda: "ready" in away.log_tail(), WAIT_S, "the one that is away")
    dds.peer("here", pose)
    ros_graph.wait_for(lambda: bool(heard.senders), WAIT_S, "the one that is here")
    assert heard.senders == {"/ros2_here"}


@pytest.mark.parametrize(
    ("params", "missing", "said"),
    [
        ({"interface": "nope"}, "", "no network interface 'nope'; there are lo"),
        ({"domain": 233}, "", "~domain is 233; allowed: a whole number from 0 to 232"),
        ({"contract": "/nowhere.yaml"}, "", "/nowhere.yaml: no contract of topics"),
        ({"enclave": "/nowhere"}, "", "/nowhere/identity_ca.cert.pem: no such file"),
        ({}, "cyclonedds", "cyclonedds"),
        ({}, "roswell", "roswell"),
    ],
)
def test_a_gateway_that_cannot_run_says_why(
    ros_graph: RosGraph, tmp_path: Path, params: dict[str, object], missing: str, said: str
) -> None:
    (tmp_path / "sitecustomize.py").write_text(f"import sys\nsys.modules[{missing!r}] = None\n")
    env = {"PYTHONPATH": f"{tmp_path}:{ros_graph.env.get('PYTHONPATH', '')}"}
    node = Dds(ros_graph).gateway(env=env, **params)
    ros_graph.wait_for(lambda: node.exit_code is not None, WAIT_S, "its end")
    cure = "./surg up CELL --ros2 installs it" if missing else ""
    last = node.log_tail(1)
    assert (node.exit_code, said in last, cure in last) == (2, True, True), node.log_tail()


def test_without_the_means_of_dds_security_it_ends(ros_graph: RosGraph, tmp_path: Path) -> None:
    """The libddsc of PyPI has none, and no plug-ins are there for another one."""
    enclave = keystore.enclave(keystore.authority(tmp_path / "keys"), "/gateway")
    node = Dds(ros_graph).gateway(enclave=enclave)
    ros_graph.wait_for(lambda: node.exit_code is not None, WAIT_S, "its end")
    assert node.exit_code == 2
    assert "DDS Security needs a libddsc with it (PyPI's has none)" in node.log_tail(1)
    assert "libdds_security_auth.so" in node.log_tail(1)
