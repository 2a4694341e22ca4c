"""The node /<arm>/drive on a graph, with emulated servos on a pseudo-terminal."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import surg_core
from helpers.graph.ros import RosGraph
from helpers.hardware.servo_bench import DRIVE, JAW, emulated_drive_cell, with_terminals
from surg_emulators.drive.drive_emulator import DriveEmulator
from surg_emulators.drive.servo_motor import TORQUE, Servo
from surg_hardware.drive.drive_file import drive_of

pytestmark = pytest.mark.ros
PATIENCE = 120.0
"""[s]"""


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    jaws = {"motors": {"jaw": JAW}, "coupling": {"jaw": [1]}}
    return emulated_drive_cell(tmp_path, {**DRIVE, **jaws})


@pytest.fixture
def emulator(cell: Path) -> Iterator[DriveEmulator]:
    """One servo between its stops; its zero is 0."""
    with_terminals()
    port = drive_of(surg_core.load_cell(cell), "PSM1").port
    emulator = DriveEmulator(port, [Servo(3, position=-0.1, stops=(-2.5, 0.3))])
    yield emulator
    emulator.close()


class Heard:
    """What the node says, and what it is told."""

    def __init__(self) -> None:
        import rospy
        from sensor_msgs.msg import JointState
        from std_msgs.msg import String

        from crtk_msgs.msg import OperatingState, StringStamped

        self.status, self.angles, self.warnings = "", [], []
        self._kinds = {"goal": JointState, "request": StringStamped, "state": OperatingState}
        topics = {"goal": "tool/servo_jp", "request": "tool/request", "state": "operating_state"}
        self._out = {
            name: rospy.Publisher(f"/PSM1/{topic}", self._kinds[name], queue_size=1)
            for name, topic in topics.items()
        }
        rospy.Subscriber("/PSM1/tool/measured_js", JointState, self._on_angles)
        rospy.Subscriber("/PSM1/tool/status", StringStamped, self._on_status)
        rospy.Subscriber("/PSM1/warning", String, lambda m: self.warnings.append(m.data))

    def _on_angles(self, message: Any) -> None:
        self.angles.append((message.header.stamp.to_sec(), list(message.name), message.position))

    def _on_status(self, message: Any) -> None:
        self.status = message.string

    def say(self, to: str, **fields: object) -> None:
        """Publish a message."""
        self._out[to].publish(self._kinds[to](**fields))


def test_a_drive_homes_on_request_follows_and_stops_by_name(
    ros_graph: RosGraph, rospy_node: str, cell: Path, emulator: DriveEmulator
) -> None:
    """Steps are asked for until they are done: on a busy machine the servos may answer late."""
    heard = Heard()
    servo = emulator.line.servos[0]
    ros_graph.node("surg_hardware", "drive_node", "/PSM1/drive", {"cell": cell, "arm": "PSM1"})

    def identified() -> bool:
        return heard.status.startswith("IDENTIFIED")

    ros_graph.wait_for(identified, PATIENCE, "the motor")
    assert not heard.angles and not servo.table[TORQUE]

    def refused() -> bool:
        heard.say("state", state="ENABLED")
        heard.say("request", string="home")
        return any("refused while the arm is ENABLED" in said for said in heard.warnings)

    ros_graph.wait_for(refused, PATIENCE, "the refusal")
    assert not heard.angles and not servo.table[TORQUE]

    def at(goal: float) -> bool:
        if not heard.status.startswith(("HOMING", "HOMED", "RUNNING")):
            heard.say("state", state="DISABLED")
            heard.say("request", string="home")
        heard.say("goal", name=["yaw", "jaw"], position=[9.0, goal])
        position = heard.angles[-1][2] if heard.angles else ()
        return bool(position) and abs(position[0] - goal) < 0.01

    ros_graph.wait_for(lambda: at(0.5), PATIENCE, "the jaws")
    assert servo.position == pytest.approx(-1.5 * 0.5, abs=0.1)
    assert heard.angles[-1][0] > 0.0 and heard.angles[-1][1] == ["jaw"]
    emulator.unplug()

    def failed() -> bool:
        return heard.status.startswith("FAILED") and heard.angles[-1][0] == 0.0

    ros_graph.wait_for(failed, PATIENCE, "the failure")
    assert any("PSM1: drive: FAILED: the serial port is gone" in said for said in heard.warnings)
    assert f"./surg robot {cell.name} drive home" in heard.warnings[-1]
    emulator.plug()
    ros_graph.wait_for(lambda: at(0.2), PATIENCE, "the jaws again")


def test_a_file_that_must_not_be_used_ends_the_node(ros_graph: RosGraph, cell: Path) -> None:
    (cell / "drive_PSM1.yaml").write_text("format: surg_drive/1\n", "utf-8")
    node = ros_graph.node(
        "surg_hardware", "drive_node", "/PSM1/drive", {"cell": cell, "arm": "PSM1"}
    )
    ros_graph.wait_for(lambda: node.exit_code is not None, PATIENCE, "its end")
    assert node.exit_code == 2
