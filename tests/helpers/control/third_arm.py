"""A third arm that is not in the tree: six axes of another build, written as one URDF and one YAML.

It differs from the two bundled arms wherever an arm can differ: a spherical wrist, joint axes along
x, y and minus z instead of z everywhere, a base turned by 90 degrees on a pedestal, joint frames
that are no DH frames, other names, joint velocities of its own, and a last joint that turns the
other way than its flange's z. docs/guide/adding_a_robot.md tells the story.
"""

from __future__ import annotations

from pathlib import Path

import yaml

NAME = "third_arm"
JOINTS = ("turn", "lean", "bend", "twist", "nod", "spin")
HOME = (0.115, 0.443, -1.013, 0.009, 1.185, 1.4)
"""rad; found by the same search as the bundled homes."""

_HALF_PI = "1.5707963267948966"
# parent, child, xyz [m], rpy [rad], axis, lower, upper [rad], velocity [rad/s], link: xyz, length
_CHAIN = (
    ("pedestal", "column", "0 0 0.28", f"0 0 {_HALF_PI}", "0 0 -1", -2.9, 2.9, 3.5),
    ("column", "upper", "0.03 0 0.14", "0 0 0", "0 1 0", -2.2, 2.2, 3.5),
    ("upper", "fore", "0 0 0.46", f"0 {_HALF_PI} 0", "0 1 0", -2.6, 2.6, 4.0),
    ("fore", "roller", "0.12 0 0.035", "0 0 0", "1 0 0", -3.1, 3.1, 5.5),
    ("roller", "wrist", "0.30 0 0", "0 0 0", "0 1 0", -2.1, 2.1, 5.5),
    ("wrist", "disc", "0.05 0 0", "0 0 0", "-1 0 0", -6.1, 6.1, 6.0),
)
_FLANGE = ("disc", "plate", "0.05 0 0", f"0 {_HALF_PI} 0")
_MASSES = {
    "pedestal": 8.0,
    "column": 5.0,
    "upper": 6.0,
    "fore": 3.0,
    "roller": 2.0,
    "wrist": 1.0,
    "disc": 0.4,
}  # kg
_ACCELERATION = 40.0  # rad/s^2


def write_third_arm(folder: Path, limits_of: Path) -> Path:
    """Writes the arm's files.

    Args:
        folder: Where; made if missing.
        limits_of: A bundled robot YAML whose tip limits and tuning are taken over.

    Returns:
        The robot YAML; ``<folder>/third_arm.urdf`` lies beside it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{NAME}.urdf").write_text(_urdf(), encoding="utf-8")
    model = yaml.safe_load(limits_of.read_text(encoding="utf-8"))
    robot = {
        "format": "surg_robot/1",
        "name": NAME,
        "urdf": f"{NAME}.urdf",
        "base_link": "pedestal",
        "flange_link": "plate",
        "command": "joint_velocity",
        "joints": {
            "names": list(JOINTS),
            "home": list(HOME),
            "position_min": [float(joint[5]) for joint in _CHAIN],
            "position_max": [float(joint[6]) for joint in _CHAIN],
            "velocity": [float(joint[7]) for joint in _CHAIN],
            "acceleration": [_ACCELERATION] * len(JOINTS),
        },
        "limits": model["limits"],
        "tuning": model["tuning"],
    }
    path = folder / f"{NAME}.yaml"
    path.write_text(yaml.safe_dump(robot, sort_keys=False), encoding="utf-8")
    return path


def _urdf() -> str:
    parts = ['<robot name="third_arm">']
    parts.append('<mujoco><compiler fusestatic="false" discardvisual="false"/></mujoco>')
    for link, mass in _MASSES.items():
        moment = mass * 0.004  # a ball of 0.1 m radius
        parts.append(
            f'<link name="{link}"><inertial><origin xyz="0 0 0"/><mass value="{mass}"/>'
            f'<inertia ixx="{moment}" iyy="{moment}" izz="{moment}" ixy="0" ixz="0" iyz="0"/>'
            '</inertial><visual><geometry><sphere radius="0.05"/></geometry></visual></link>'
        )
    parts.append('<link name="plate"/>')
    for name, (parent, child, xyz, rpy, axis, lower, upper, velocity) in zip(
        JOINTS, _CHAIN, strict=True
    ):
        parts.append(
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/>'
            f'<child link="{child}"/><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
            f'<limit lower="{lower}" upper="{upper}" effort="150" velocity="{velocity}"/></joint>'
        )
    parent, child, xyz, rpy = _FLANGE
    parts.append(
        f'<joint name="plate_joint" type="fixed"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/></joint>'
    )
    return "\n".join([*parts, "</robot>"]) + "\n"
