"""DDS Security: who has a certificate of the keystore's authority talks, nobody else does."""

from __future__ import annotations

import json
import random
import time
from pathlib import Path
from typing import Any

import pytest
import rospy
from geometry_msgs.msg import PoseStamped

from crtk_msgs.msg import OperatingState
from crtk_msgs.srv import QueryForwardKinematics, QueryForwardKinematicsResponse
from helpers.graph.ros import RosGraph
from helpers.results.ros2_results import note
from helpers.ros2 import drawn_messages as drawn
from helpers.ros2 import interfaces, keystore, secure_dds
from helpers.ros2.dds_peers import COMMAND, POSE, Dds
from surg_cli.graph.processes import Child
from surg_cli.host import paths
from surg_ros2.bridged_topics import IMPLEMENTATIONS

pytest.importorskip("cyclonedds", reason="missing: ./surg dev setup --all installs cyclonedds")
pytestmark = [pytest.mark.ros, pytest.mark.oracle]

FOLDER = paths.ROOT / "tests" / "helpers" / "ros2"
STATE = "/PSM1/operating_state"
STATE_TYPE = "crtk_msgs/OperatingState"
SERVICE, KIND = "/PSM1/forward_kinematics", "crtk_msgs/QueryForwardKinematics"
SAID = "an answer to whom it may concern"
WAIT_S = 90.0
LONGER_S = 10.0
"""[s] For which strangers still have the time to be heard."""


class Graph:
    """The ROS 1 side, and a domain whose processes may have DDS Security."""

    def __init__(self, graph: RosGraph, folder: Path, rng: random.Random) -> None:
        self.env = secure_dds.environment(graph)
        self.ours, self.theirs = (keystore.authority(folder / name) for name in ("ours", "theirs"))
        self.dds, self.graph = Dds(graph), graph
        self.state = drawn.draw(STATE_TYPE, rng)
        self.pose = drawn.cdr(POSE, drawn.draw(POSE, rng)).hex()
        self.senders: set[str] = set()
        self._said = rospy.Publisher(STATE, OperatingState, latch=True, queue_size=1)
        self._said.publish(self.state)
        self._ear = rospy.Subscriber(COMMAND, PoseStamped, self._hear)

    def _hear(self, message: Any) -> None:
        self.senders.add(message._connection_header["callerid"])

    def gateway(self, *topics: str, **more: object) -> Child:
        """Start it; without topics it may use all."""
        made = keystore.enclave(self.ours, "/gateway", topics or keystore.ALL)
        return self.dds.gateway(env=self.env, enclave=made, **more)

    def peer(self, name: str, enclave: Path | None) -> Child:
        """Start a process that commands and hears the state."""
        secret = {} if enclave is None else {"PEER_ENCLAVE": str(enclave)}
        return self.dds.peer(name, self.pose, f"{STATE}!={STATE_TYPE}", env={**self.env, **secret})

    def heard(self, peer: Child) -> bool:
        """Whether it has heard the state."""
        return f"{STATE} {drawn.cdr(STATE_TYPE, self.state).hex()}" in peer.log_tail(1000)


@pytest.fixture
def secured(ros_graph: RosGraph, rospy_node: str, tmp_path: Path, rng: random.Random) -> Graph:
    return Graph(ros_graph, tmp_path, rng)


def test_who_has_no_certificate_neither_hears_nor_commands(secured: Graph) -> None:
    node = secured.gateway()
    stranger = keystore.enclave(secured.theirs, "/stranger")
    others = [secured.peer("open", None), secured.peer("stranger", stranger)]
    wait = secured.graph.wait_for
    wait(lambda: all("ready" in each.log_tail(1000) for each in others), WAIT_S, "the strangers")
    good = secured.peer("good", keystore.enclave(secured.ours, "/good"))
    wait(
        lambda: secured.heard(good) and bool(secured.senders), WAIT_S, "the one with a certificate"
    )
    time.sleep(LONGER_S)
    assert secured.senders == {"/ros2_good"}
    assert [each.name for each in others if STATE in each.log.read_text()] == []
    assert (
        f"services: none in a secured domain without RMW_IMPLEMENTATION={IMPLEMENTATIONS[1]}"
        in (node.log_tail(1000))
    )
    assert node.exit_code is None
    note("DDS Security: processes with, and without a certificate", 3, "1 heard, 2 not")


def test_a_topic_that_its_permissions_lack_is_named_and_the_others_work(secured: Graph) -> None:
    node = secured.gateway("ros_discovery_info", f"rt{COMMAND}")
    secured.peer("good", keystore.enclave(secured.ours, "/good"))
    secured.graph.wait_for(lambda: bool(secured.senders), WAIT_S, "a command")
    said = f"{STATE}: DDS does not make rt{STATE}"
    secured.graph.wait_for(lambda: said in node.log_tail(1000), WAIT_S, said)
    assert "permissions.p7s must allow it" in node.log_tail(1000)
    assert node.exit_code is None


def test_rclpy_talks_with_its_security_files_only(secured: Graph, tmp_path: Path) -> None:
    python, env = interfaces.rclpy(IMPLEMENTATIONS[1])
    asked: list[tuple[float, ...]] = []
    answer = QueryForwardKinematicsResponse(message=SAID)
    server = rospy.Service(
        SERVICE, QueryForwardKinematics, lambda q: asked.append(tuple(q.jp)) or answer
    )
    secured.gateway(implementation=IMPLEMENTATIONS[1])
    keystore.enclave(secured.ours, "/rclpy")
    env["ROS_DOMAIN_ID"] = str(secured.dds.domain)
    env["LD_LIBRARY_PATH"] += f":{secure_dds.DEBIAN}"
    secret = {
        "ROS_SECURITY_ENABLE": "true",
        "ROS_SECURITY_STRATEGY": "Enforce",
        "ROS_SECURITY_KEYSTORE": str(secured.ours),
        "ROS_SECURITY_ENCLAVE_OVERRIDE": "/rclpy",
    }
    half = {"position": dict.fromkeys("xyz", 0.5), "orientation": dict.fromkeys("xyzw", 0.5)}
    pose = {"header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "a"}, "pose": half}
    question = {"jp": [0.25], "cp": half}

    def start(name: str, more: dict[str, str], script: str = "rclpy_script.py") -> Child:
        spec = tmp_path / f"{name}.json"
        told = {"hear": {STATE: [STATE_TYPE, True, True]}, "say": {COMMAND: [POSE, pose]}}
        spec.write_text(json.dumps({"node": name, "ask": {SERVICE: [KIND, question]}, **told}))
        words = [str(python), str(FOLDER / script), str(spec)]
        return secured.graph.supervisor.start(name, words, extra_env={**env, **more})

    bare = start("bare", {})
    secured.graph.wait_for(lambda: "ready" in bare.log_tail(), WAIT_S, "rclpy without files")
    known, asks = start("known", secret), start("asks", secret, "rclpy_services.py")
    deaf = start("deaf", {}, "rclpy_services.py")

    def heard() -> bool:
        return f'["{STATE}"' in known.log_tail(1000) and bool(secured.senders)

    secured.graph.wait_for(heard, WAIT_S, "rclpy with its files")
    time.sleep(LONGER_S)
    assert secured.senders == {"/ros2_known"}
    secured.graph.wait_for(lambda: SAID in asks.log_tail(1000), WAIT_S, "an answer")
    assert STATE not in bare.log.read_text() and SAID not in deaf.log.read_text()
    assert set(asked) == {(0.25,)}
    server.shutdown()
    note("rclpy in a secured domain (Cyclone)", 2, "heard with its files, not without")
