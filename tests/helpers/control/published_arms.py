"""Robots that vendors describe in public, made into a YAML as docs/guide/adding_a_robot.md says.

``SURG_ROBOT_DESCRIPTIONS`` names a folder with one plain URDF for each: ``<name>.urdf``, written by
xacro where the repository holds xacro. Nothing of them lies in the tree.
"""

from __future__ import annotations

import math
import os
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

import pytest
import yaml

from helpers.graph.surg import surg
from surg_cli.host import paths
from surg_core.urdf import UrdfJoint, load_urdf
from surg_description.make_cell import ArmPlan, make_cell_of

VARIABLE = "SURG_ROBOT_DESCRIPTIONS"
DESCRIPTION = paths.ROOT / "src" / "surg_description"
GRASPER = DESCRIPTION / "instruments" / "grasper.yaml"
SPEED_UP = 0.2
"""[s] In which a joint reaches its speed: URDF states no acceleration. Assumed."""
FASTEST, LARGEST = 6.5, 50.0
"""[rad/s], [rad/s^2] Largest that a robot's YAML may state."""
TURN = 6.2832
"""[rad] Range of a continuous joint, to either side."""
PLACES = {"wall": (0.0, math.pi / 2, 0.0), "ceiling": (math.pi, 0.0, 0.0)}
"""Roll, pitch, yaw of a base [rad]."""


@dataclass(frozen=True)
class Published:
    """Where a description is from, and the two links between which its arm lies."""

    vendor: str
    source: str  # owner and name of the repository
    base: str
    flange: str
    place: str = ""  # of PLACES; empty: the base stands upright
    bent: float | None = (
        None  # third joint's angle that the search begins with [rad]; None: 0 or so
    )


_UR, _KUKA = "UniversalRobots/Universal_Robots_ROS2_Description", "lbr-stack/lbr_fri_ros2_stack"
_FRANKA, _DOOSAN = "frankaemika/franka_description", "doosan-robotics/doosan-robot"
_JACO, _KORTEX = "Kinovarobotics/kinova-ros", "Kinovarobotics/ros_kortex"
_XARM, _TM = "xArm-Developer/xarm_ros", "TechmanRobotInc/tmr_ros1"
_RI, _DATA = "ros-industrial", "Gepetto/example-robot-data"
_LBR = ("lbr_link_0", "lbr_link_ee")
ARMS = {
    **{
        name: Published("Universal Robots", _UR, "base_link", "tool0")
        for name in ("ur3", "ur5", "ur10", "ur16e", "ur20", "ur30")
    },
    "ur5_wall": Published("Universal Robots", _UR, "base_link", "tool0", "wall"),
    "ur10_ceiling": Published("Universal Robots", _UR, "base_link", "tool0", "ceiling"),
    "fer": Published("Franka", _FRANKA, "fer_link0", "fer_link8"),
    "fr3": Published("Franka", _FRANKA, "fr3_link0", "fr3_link8"),
    **{name: Published("KUKA", _KUKA, *_LBR) for name in ("iiwa7", "iiwa14", "med7", "med14")},
    "gen3_6": Published("Kinova", _KORTEX, "base_link", "end_effector_link"),
    "gen3_7": Published("Kinova", _KORTEX, "base_link", "end_effector_link"),
    "jaco_j2s7s300": Published("Kinova", _JACO, "j2s7s300_link_base", "j2s7s300_end_effector"),
    "jaco_j2s6s200": Published("Kinova", _JACO, "j2s6s200_link_base", "j2s6s200_end_effector"),
    "xarm6": Published("UFACTORY", _XARM, "link_base", "link_eef"),
    "uf850": Published("UFACTORY", _XARM, "link_base", "link_eef"),
    "lite6": Published("UFACTORY", _XARM, "link_base", "link_eef"),
    "sawyer": Published(
        "Rethink", "RethinkRobotics/sawyer_robot", "right_arm_base_link", "right_hand"
    ),
    "z1": Published("Unitree", _DATA, "link00", "link06"),
    "dsr_m1013": Published("Doosan", _DOOSAN, "base_0", "link6"),
    "dsr_h2017": Published("Doosan", _DOOSAN, "base_0", "link6", bent=1.57),
    "tm5_900": Published("Techman", _TM, "link_0", "flange_link"),
    "cr7ia": Published("Fanuc", f"{_RI}/fanuc", "base_link", "tool0"),
    "lrmate200id": Published("Fanuc", f"{_RI}/fanuc", "base_link", "tool0"),
    "hc10": Published("Yaskawa", f"{_RI}/motoman", "base_link", "tool0"),
    "gp8": Published("Yaskawa", f"{_RI}/motoman", "base_link", "tool0"),
    "kr6r900sixx": Published("KUKA", f"{_RI}/kuka_experimental", "base_link", "tool0"),
    "irb2400": Published("ABB", f"{_RI}/abb", "base_link", "tool0"),
    "rx160": Published("Stäubli", f"{_RI}/staubli", "base_link", "tool0", bent=1.57),
}
"""By the name of the URDF, without its place."""


@dataclass
class Trial:
    """One arm on its way from URDF to demo."""

    robot: Path  # its YAML
    document: dict[str, object]  # what stands in it
    place: str

    @property
    def joints(self) -> dict[str, object]:
        """The part of the YAML about joints."""
        found = self.document["joints"]
        assert isinstance(found, dict)
        return found

    @property
    def tip_acceleration(self) -> float:
        """Of the tip, as the YAML limits it [m/s^2]."""
        return float(self.document["limits"]["tip_acceleration"])  # type: ignore[index]

    def write(self) -> Path:
        """Write the YAML, and a cell where the arm is mounted; returns what the commands take."""
        self.robot.write_text(yaml.safe_dump(self.document, sort_keys=False))
        if not self.place:
            return self.robot
        plan = ArmPlan(self.robot, GRASPER, base_xyz=(0, 0, 1), base_rpy=PLACES[self.place])
        return make_cell_of(self.robot.parent / "cell", {"PSM1": plan}).parent

    def find_home(self) -> str:
        """Ask `./surg robot home`, lower tip_acceleration to what it advises, and take the home.

        Returns why there is none; empty: there is one.
        """
        for _ in range(4):  # each home is one for the acceleration that it was asked for
            done = surg("robot", "home", self.write(), timeout_s=600.0)
            said = done.stdout + done.stderr
            found = re.search(r"^home: (\[.*?\])", said, re.MULTILINE)
            if not found:
                return said.strip().splitlines()[-1]
            self.joints["home"] = yaml.safe_load(found[1])
            advised = re.search(r"([0-9.]+) m/s\^2 would do", said)
            if done.returncode == 0 or not advised:
                break
            self.document["limits"]["tip_acceleration"] = float(advised[1])  # type: ignore[index]
        return ""

    def shortcomings(self) -> list[str]:
        """What `./surg robot check` finds wanting; empty: the arm is ready."""
        done = surg("robot", "check", self.write(), timeout_s=600.0)
        assert done.returncode in (0, 1), done.stderr
        found = [line.removeprefix("surg: ") for line in done.stderr.splitlines()]
        wanting = [line for line in found if not line.startswith("./surg")]
        assert bool(wanting) == bool(done.returncode), done.stderr
        return wanting


def folder() -> Path:
    """The folder with the URDFs; without it the test is skipped as missing."""
    found = Path(os.environ.get(VARIABLE, "") or "/nonexistent")
    if not found.is_dir():
        pytest.skip(f"missing: name a folder with the URDFs of ARMS in {VARIABLE}")
    return found


def begin(name: str, arm: Published, out: Path) -> Trial:
    """Copy a description and write its YAML: the UR5e's, with the URDF's joints."""
    given = folder() / f"{name.removesuffix(f'_{arm.place}')}.urdf"
    if not given.is_file():
        pytest.skip(f"missing: {given.name}, from github.com/{arm.source}")
    shutil.copy(given, out / f"{name}.urdf")
    document = yaml.safe_load((DESCRIPTION / "robots" / "ur5e.yaml").read_text("utf-8"))
    del document["capsules"]
    joints = turning(out / f"{name}.urdf", arm.base, arm.flange)
    ranges = [_range(joint) for joint in joints]
    speeds = [
        math.floor(1e4 * min(j.limit.velocity if j.limit else 1.0, FASTEST)) / 1e4 for j in joints
    ]
    document |= {"name": name, "urdf": f"{name}.urdf"}
    document |= {"base_link": arm.base, "flange_link": arm.flange}
    document["joints"] = {
        "names": [joint.name for joint in joints],
        "home": [round((low + high) / 2, 4) for low, high in ranges],
        "position_min": [low for low, _ in ranges],
        "position_max": [high for _, high in ranges],
        "velocity": speeds,
        "acceleration": [round(min(speed / SPEED_UP, LARGEST), 2) for speed in speeds],
    }
    if arm.bent is not None:
        document["joints"]["home"][2] = arm.bent
    return Trial(out / "robot.yaml", document, arm.place)


def turning(urdf: Path, base: str, flange: str) -> list[UrdfJoint]:
    """The turning joints from base to flange, in order."""
    above = {joint.child: joint for joint in load_urdf(urdf).joints}
    way, link = [], flange
    while link != base:
        way.append(above[link])
        link = above[link].parent
    return [joint for joint in reversed(way) if joint.turning]


def _range(joint: UrdfJoint) -> tuple[float, float]:
    """Of a joint, rounded inwards to what a YAML says [rad]."""
    if joint.kind == "continuous":
        return -TURN, TURN
    return math.ceil(joint.limit.lower * 1e4) / 1e4, math.floor(joint.limit.upper * 1e4) / 1e4
