"""Three machines on one switch: robot and endoscope with ROS 1, the operator with ROS 2 alone."""

from __future__ import annotations

import contextlib
import io
import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from PIL import Image
from sensor_msgs.msg import CompressedImage, JointState

from crtk_msgs.msg import OperatingState, StringStamped
from helpers.graph.surg import argv, environment
from helpers.machines.machines import Machines, isolated_cell, on_a_switch
from helpers.perception import recorded_pairs
from helpers.ros2 import drawn_messages as drawn
from helpers.ros2 import interfaces
from surg_cli.graph.processes import wait_until
from surg_cli.host import paths
from surg_ros2.cdr import Codec
from surg_ros2.message_types_node import fields

pytest.importorskip("cyclonedds", reason="missing: ./surg dev setup --all installs cyclonedds")
pytestmark = [pytest.mark.ros, pytest.mark.full]

PORT = 11378  # namespaces have ports of their own
DOMAIN = "7"
UP_S, WAIT_S = 120.0, 90.0
SIZE = (320, 240)
"""[pixels] Of an eye."""
STATE, LINK, PICTURE = (
    "/PSM1/operating_state",
    "/PSM1/robot/measured_js",
    "/endoscope/left/image_raw",
)
TYPES = {STATE: OperatingState, LINK: JointState, f"{PICTURE}/compressed": CompressedImage}
HEAR = {name: kind._type for name, kind in TYPES.items()}
MARK = {STATE: "!", f"{PICTURE}/compressed": "?"}
"""Latched; some may be lost."""
COMMAND = "/PSM1/state_command"
FOLDER = paths.ROOT / "tests" / "helpers" / "ros2"


@pytest.fixture
def machines() -> Iterator[Machines]:
    try:
        with on_a_switch("robot", "operator", "endoscope") as found:
            yield found
    except PermissionError as error:
        pytest.skip(f"network namespaces are not permitted here: {error}")


@pytest.fixture
def cell(machines: Machines, tmp_path: Path) -> Path:
    """A simulated arm, and an endoscope that plays a file on a machine of its own."""
    endoscope = {"source": "file:pairs.mp4?loop", "layout": "sbs"}
    folder = isolated_cell(machines, tmp_path, endoscope=endoscope)
    recorded_pairs.side_by_side(folder / "pairs.mp4", 60, *SIZE)
    return folder


@contextlib.contextmanager
def running(
    machines: Machines, machine: str, log: Path, words: list[str], env: dict[str, str]
) -> Iterator[subprocess.Popen[bytes]]:
    """A program on a machine, ended as Ctrl-C does."""
    with log.open("wb") as stream:
        process = subprocess.Popen(
            machines.on(machine, *words),
            env=env,
            cwd=paths.ROOT,
            stdout=stream,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
        )
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(30)
        except subprocess.TimeoutExpired:
            process.kill()
        print(f"-- {machine}\n{log.read_text('utf-8', 'replace')[-2000:]}")


Start = Callable[[Path, str], tuple[list[str], dict[str, str]]]
Read = Callable[[str], tuple[str, Any]]


def with_cyclone(folder: Path, interface: str) -> tuple[list[str], dict[str, str]]:
    """The operator's program as a process of Cyclone's own binding, and its variables."""
    command = drawn.cdr("crtk_msgs/StringStamped", StringStamped(string="enable")).hex()
    say = ["operator", COMMAND, "crtk_msgs/StringStamped", "0.2", command]
    hear = [f"{name}{MARK.get(name, '')}={kind}" for name, kind in HEAR.items()]
    words = [sys.executable, str(FOLDER / "peer.py"), DOMAIN, *say, *hear]
    return words, {"PEER_INTERFACE": interface}


def with_rclpy(folder: Path, interface: str) -> tuple[list[str], dict[str, str]]:
    """As a node of real rclpy on Fast DDS."""
    python, env = interfaces.rclpy()
    marks = {name: MARK.get(name, "") for name in HEAR}
    hear = {name: [HEAR[name], mark == "!", mark != "?"] for name, mark in marks.items()}
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    say = {COMMAND: ["crtk_msgs/StringStamped", {"header": header, "string": "enable"}]}
    spec = folder / "spec.json"
    spec.write_text(json.dumps({"node": "operator", "hear": hear, "say": say}))
    return [str(python), str(FOLDER / "rclpy_script.py"), str(spec)], env


def of_cyclone(line: str) -> tuple[str, Any]:
    """Topic and message of a line that this program prints."""
    topic, text = line.split()
    made = TYPES[topic]()
    return topic, made.deserialize(Codec(made._type, fields).to_ros1(bytes.fromhex(text)))


def of_rclpy(line: str) -> tuple[str, Any]:
    """As `of_cyclone`."""
    topic, given = json.loads(line)
    return topic, SimpleNamespace(**given)


@pytest.mark.parametrize(
    ("start", "read"),
    [
        pytest.param(with_cyclone, of_cyclone, id="cyclone"),
        pytest.param(with_rclpy, of_rclpy, id="rclpy", marks=pytest.mark.oracle),
    ],
)
def test_the_operator_sees_the_other_machines_and_enables_the_arm(
    machines: Machines, cell: Path, tmp_path: Path, start: Start, read: Read
) -> None:
    """What the operator hears and says goes over DDS: its machine has no node of ROS 1."""
    logs = {name: tmp_path / f"{name}.log" for name in machines.names}
    interface = machines.interfaces
    up = ["--port", str(PORT), "--role"]
    robot = argv("up", cell, *up, "robot", "--ros2", interface["robot"], "--ros2-commands")
    scope = argv("up", cell, *up, "endoscope")
    env = {**environment(), "ROS_DOMAIN_ID": DOMAIN}
    hand, more = start(tmp_path, interface["operator"])
    env.pop("ROS_MASTER_URI", None)

    def said(machine: str, text: str) -> bool:
        return text in logs[machine].read_text("utf-8", "replace")

    with running(machines, "robot", logs["robot"], robot, env) as process:
        assert wait_until(lambda: process.poll() is not None or said("robot", "is up:"), UP_S)
        with (
            running(machines, "endoscope", logs["endoscope"], scope, env),
            running(machines, "operator", logs["operator"], hand, {**env, **more}),
        ):
            found: dict[str, Any] = {}

            def all_heard() -> bool:
                lines = logs["operator"].read_text("utf-8", "replace").splitlines()[:-1]
                found.update(read(line) for line in lines if line.startswith(("/", "[")))
                state = found.get(STATE)
                return len(found) == len(HEAR) and state is not None and state.state == "ENABLED"

            assert wait_until(all_heard, WAIT_S), sorted(found)
            assert process.poll() is None
    picture = bytes(found[f"{PICTURE}/compressed"].data)
    assert Image.open(io.BytesIO(picture)).size == SIZE
