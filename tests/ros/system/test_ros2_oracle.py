"""Real rclpy, on Fast DDS and on Cyclone, hears, says and asks what is in the contract but `/tf`.

PyPI has no ROS 2 package of tf2_msgs. What its type becomes is compared with `rosbags`, as every
other type is.
"""

from __future__ import annotations

import json
import random
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import rospy

from helpers.graph import public_scripts
from helpers.graph.ros import RosGraph
from helpers.results.ros2_results import note
from helpers.ros2 import drawn_messages as drawn
from helpers.ros2 import interfaces
from helpers.ros2.plain_values import values
from helpers.tree import oracle_venv
from surg_cli.graph import topic_contract
from surg_cli.graph.processes import Child
from surg_cli.host import paths
from surg_msgs.msg import SimStatus
from surg_ros2.bridged_topics import IMPLEMENTATIONS, INSIDE, PICTURES
from surg_ros2.cdr import Codec
from surg_ros2.message_types_node import fields, service_class

pytest.importorskip("cyclonedds", reason="missing: ./surg dev setup --all installs cyclonedds")
pytestmark = [pytest.mark.ros, pytest.mark.oracle]

FOLDER = paths.ROOT / "tests" / "helpers" / "ros2"
HAVE = (
    "crtk_msgs/",
    "surg_msgs/",
    "std_msgs/",
    "geometry_msgs/",
    "sensor_msgs/",
    "diagnostic_msgs/",
    "rosgraph_msgs/",
)
WAIT_S = 120.0
LOCKSTEP_S = 400.0
CIRCLE = 500
"""Ticks in which the script sends poses."""
POSES, SETTLED, LEAST = 3000, 200, 0.5
"""Poses that are sent, those of them that begin, the part of the others that must arrive."""
MIDDLE_MS = 5.0
"""[ms] Most that half of them may need."""
DRAWS = 200
SIZES = (100_000, 1_000_000)
"""[bytes] Of pictures."""


Note = Callable[[str, int, str], None]


def of(direction: str) -> dict[str, topic_contract.Entry]:
    """The topics of one direction whose types rclpy has, by name."""
    found = {}
    for entry in topic_contract.load().entries:
        name = "/" + entry.name.lstrip("/").replace("<arm>", "PSM1").replace("<leader>", "pad")
        closed = direction == "in" and INSIDE.fullmatch(name)
        if entry.direction == direction and entry.type.startswith(HAVE) and not closed:
            found[name] = entry
    return found


@pytest.fixture(params=IMPLEMENTATIONS)
def implementation(request: pytest.FixtureRequest) -> str:
    """Of ROS 2 on DDS."""
    return str(request.param)


@pytest.fixture
def keep(implementation: str) -> Note:
    """Keep a figure; Cyclone's has a row of its own, below that of which it is the same."""
    if implementation == IMPLEMENTATIONS[1]:
        return lambda row, cases, result: note(f"{row} (Cyclone)", cases, "the same")
    return note


@pytest.fixture
def rclpy(ros_graph: RosGraph, tmp_path: Path, implementation: str) -> Callable[..., Child]:
    """Starts the gateway, and then real rclpy."""
    python, env = interfaces.with_gateway(ros_graph, implementation)

    def start(
        hear: dict[str, Any],
        say: dict[str, Any],
        script: str = "rclpy_script.py",
        ask: dict[str, Any] | None = None,
    ) -> Child:
        spec = tmp_path / "spec.json"
        spec.write_text(json.dumps({"node": "oracle", "hear": hear, "say": say, "ask": ask}))
        words = [str(python), str(FOLDER / script), str(spec)]
        return ros_graph.supervisor.start("rclpy", words, extra_env=env)

    return start


def heard(child: Child) -> dict[str, list[Any]]:
    """What rclpy has printed, by topic."""
    found: dict[str, list[Any]] = {}
    for line in child.log.read_text("utf-8", "replace").splitlines():
        if line.startswith("[") and line.endswith("]"):
            topic, given = json.loads(line)
            found.setdefault(topic, []).append(given)
    return found


def test_every_topic_reaches_rclpy_with_every_field(
    ros_graph: RosGraph,
    rospy_node: str,
    rng: random.Random,
    rclpy: Callable[..., Child],
    keep: Note,
) -> None:
    sent, publishers = {}, {}
    for name, entry in of("out").items():
        sent[name] = drawn.draw(entry.type, rng)
        made, latched = type(sent[name]), entry.latched[1]
        publishers[name] = rospy.Publisher(name, made, latch=latched, queue_size=1)
        if latched:  # once, before anybody hears: rclpy comes late
            publishers[name].publish(sent[name])
    hear = {
        name: [entry.type, entry.latched[1], entry.type not in PICTURES]
        for name, entry in of("out").items()
    }
    child = rclpy(hear, {})

    def missing() -> list[str]:
        for name, entry in of("out").items():
            if not entry.latched[1]:
                publishers[name].publish(sent[name])
        return sorted(set(sent) - set(heard(child)))

    ros_graph.wait_for(lambda: not missing(), WAIT_S, f"rclpy to hear {len(sent)} topics")
    got = heard(child)
    wrong = [n for n, message in sent.items() if any(v != values(message) for v in got[n])]
    assert wrong == []
    late = sum(entry.latched[1] for entry in of("out").values())
    keep("rclpy hears", len(sent), f"every field equal; {late} latched topics for a late joiner")


def test_every_command_of_rclpy_arrives_with_every_field(
    ros_graph: RosGraph,
    rospy_node: str,
    rng: random.Random,
    rclpy: Callable[..., Child],
    keep: Note,
) -> None:
    got: dict[str, Any] = {}
    sent = {name: drawn.draw(entry.type, rng) for name, entry in of("in").items()}
    ears = [
        rospy.Subscriber(name, type(m), lambda m, name=name: got.update({name: m}))
        for name, m in sent.items()
    ]
    rclpy({}, {name: [m._type, values(m)] for name, m in sent.items()})
    ros_graph.wait_for(lambda: len(got) == len(sent), WAIT_S, f"{len(sent)} commands of rclpy")
    wrong = [name for name, m in sent.items() if values(got[name]) != values(m)]
    assert wrong == []
    keep("rclpy commands", len(ears), "every field equal")
    assert {m._connection_header["callerid"] for m in got.values()} == {"/ros2_oracle"}


def test_every_service_is_asked_by_rclpy(
    ros_graph: RosGraph,
    rospy_node: str,
    rng: random.Random,
    rclpy: Callable[..., Child],
    keep: Note,
) -> None:
    requests, replies, servers = {}, {}, []
    for entry in topic_contract.load().entries:
        if entry.direction == "service":
            made, name = service_class(entry.type), entry.resolved("PSM1")
            request, reply = (
                drawn.filled(half, rng) for half in (made._request_class, made._response_class)
            )
            requests[name], replies[name] = [entry.type, values(request)], values(reply)
            servers.append(rospy.Service(name, made, same(request, reply)))
    child = rclpy({}, {}, "rclpy_services.py", requests)
    ros_graph.wait_for(lambda: len(heard(child)) == len(servers), WAIT_S, "all replies")
    for server in servers:
        server.shutdown()
    assert {name: each[0] for name, each in heard(child).items()} == replies
    keep("rclpy asks services", len(servers), "every field of request and reply equal")


def same(request: Any, reply: Any) -> Callable[[Any], Any]:
    """Answers this request only."""
    return lambda asked: reply if drawn.packed(asked) == drawn.packed(request) else None


def test_large_pictures_reach_rclpy(
    ros_graph: RosGraph,
    rospy_node: str,
    rng: random.Random,
    rclpy: Callable[..., Child],
    keep: Note,
) -> None:
    from sensor_msgs.msg import CompressedImage

    topics = [f"/endoscope/{eye}/image_raw/compressed" for eye in ("left", "right")]
    pictures = [CompressedImage(format="jpeg", data=rng.randbytes(size)) for size in SIZES]
    publishers = [rospy.Publisher(name, CompressedImage, queue_size=1) for name in topics]
    child = rclpy({name: ["sensor_msgs/CompressedImage", False, False] for name in topics}, {})

    def arrived() -> bool:
        for publisher, picture in zip(publishers, pictures, strict=True):
            publisher.publish(picture)
        return len(heard(child)) == len(SIZES)

    ros_graph.wait_for(arrived, WAIT_S, "both pictures")
    for name, picture in zip(topics, pictures, strict=True):
        assert all(bytes(each["data"]) == picture.data for each in heard(child)[name])
    keep("pictures to rclpy", len(SIZES), "100 kB and 1 MB arrive, every byte equal")


def test_a_pose_at_500_hz_is_hardly_late(
    ros_graph: RosGraph, rospy_node: str, rclpy: Callable[..., Child], implementation: str
) -> None:
    from geometry_msgs.msg import PoseStamped

    on = " (Cyclone)" * (implementation == IMPLEMENTATIONS[1])
    late: list[float] = []
    ear = rospy.Subscriber(
        "/PSM1/servo_cp",
        PoseStamped,
        lambda m: late.append(time.time() - m.header.stamp.to_sec()),
        tcp_nodelay=True,
    )
    child = rclpy({}, {}, "rclpy_latency.py")
    ros_graph.wait_for(lambda: "said" in child.log_tail(), WAIT_S, "rclpy to have sent")
    report(f"ROS 2 to ROS 1, a pose at 500 Hz{on}", late)
    ear.unregister()
    out = rospy.Publisher("/PSM1/measured_cp", PoseStamped, queue_size=10, tcp_nodelay=True)
    ros_graph.wait_for(lambda: out.get_num_connections() > 0, WAIT_S, "the gateway")
    begin, pose = time.time() + 1.0, PoseStamped()
    for k in range(POSES):
        time.sleep(max(0.0, begin + 0.002 * k - time.time()))
        pose.header.stamp = rospy.Time.from_sec(time.time())
        out.publish(pose)
    printed = lambda: [n for n in child.log_tail(100).splitlines() if re.match(r"\[[\d.e-]+,", n)]  # noqa: E731
    ros_graph.wait_for(lambda: bool(printed()), WAIT_S, "rclpy to have heard")
    report(f"ROS 1 to ROS 2, a pose at 500 Hz{on}", json.loads(printed()[0]))


def test_one_script_in_lock_step_has_one_hash_from_both_sides(
    ros_graph: RosGraph, rospy_node: str
) -> None:
    client = public_scripts.folder() / "crtk_python_client" / "src"
    hashes = [in_lock_step(ros_graph, client, ros2) for ros2 in (False, True)]
    note("one CRTK script in lock-step, ROS 1 and ROS 2", 2, f"one hash, {hashes[0][:16]}")
    assert hashes[0] == hashes[1] != ""


def in_lock_step(graph: RosGraph, client: Path, ros2: bool) -> str:
    """State hash of a run that a script drives, from one side."""
    ended: list[SimStatus] = []
    ear = rospy.Subscriber("/sim/status", SimStatus, lambda m: m.state_hash and ended.append(m))
    name, python = "lockstep", Path(sys.executable)
    env = {"PYTHONPATH": f"{client}:{graph.env.get('PYTHONPATH', '')}", "ROS_VERSION": "1"}
    if ros2:
        python, env = interfaces.with_gateway(graph, mode="lockstep")
        name, env["PYTHONPATH"] = "ros2_lockstep", f"{client}:{env['PYTHONPATH']}"
    shared = {"cell": paths.ROOT / "cells" / "sim_ur5e", "mode": "lockstep", "participants": [name]}
    graph.node("surg_sim", "bridge_node.py", "/sim", shared)
    graph.node("surg_control", "rcm_node", "/PSM1/controller", {**shared, "arm": "PSM1"})
    words = [str(python), str(FOLDER / "lockstep_script.py"), name, "PSM1", str(CIRCLE)]
    script = graph.supervisor.start(
        "script", words + ["__name:=lockstep"] * (not ros2), extra_env=env
    )
    try:
        done = lambda: bool(ended) and ended[-1].state == SimStatus.STATE_DONE  # noqa: E731
        graph.wait_for(done, LOCKSTEP_S, "the run's end")
        obeyed = f"accepted {CIRCLE}"
        graph.wait_for(lambda: obeyed in script.log_tail(), WAIT_S, obeyed)
    finally:
        ear.unregister()
        graph.supervisor.stop(list(graph.supervisor.children))
    return str(ended[-1].state_hash)


def report(row: str, late: list[float]) -> None:
    """Note how late messages were [s]; no bound on the last percent: the machine may be busy."""
    late = sorted(late[SETTLED:])
    middle, most = (1e3 * late[int(len(late) * part)] for part in (0.5, 0.99))
    assert len(late) >= LEAST * (POSES - SETTLED)
    assert middle < MIDDLE_MS
    note(row, len(late), f"p50 {middle:.2f} ms, p99 {most:.2f} ms")


def test_rosbags_makes_the_same_bytes_of_every_type(rng: random.Random) -> None:
    python = oracle_venv.python("rosbags-0.11.9", [["rosbags==0.11.9"]], ["rosbags"])
    kinds = {e.type for e in topic_contract.load().entries if e.direction != "service"}
    drawings = {
        kind: [drawn.packed(drawn.draw(kind, rng)) for _ in range(DRAWS)] for kind in sorted(kinds)
    }
    given = {
        kind: [drawn.message_class(kind)._full_text, [each.hex() for each in messages]]
        for kind, messages in drawings.items()
    }
    words = [str(python), str(FOLDER / "rosbags_script.py")]
    env = {"PATH": "/usr/bin:/bin"}
    done = subprocess.run(words, input=json.dumps(given), capture_output=True, text=True, env=env)
    assert done.returncode == 0, done.stderr
    theirs = json.loads(done.stdout)
    for kind, messages in drawings.items():
        codec = Codec(kind, fields)
        for message, expected in zip(messages, theirs[kind], strict=True):
            ours = codec.to_ros2(message)
            assert ours == bytes.fromhex(expected)[: len(ours)], kind
            assert len(expected) // 2 - len(ours) < 4
    note("rosbags converts the same", len(kinds) * DRAWS, f"{len(kinds)} types, every byte equal")
