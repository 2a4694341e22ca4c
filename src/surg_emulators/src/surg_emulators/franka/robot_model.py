"""The robot model that an FR3 hands to its clients: a URDF of its kinematics and limits."""

from __future__ import annotations

from surg_emulators.franka import franka_kinematics as kinematics
from surg_emulators.franka.franka_robots import FrankaRobot

MASSES = (2.927, 2.936, 2.245, 2.616, 2.327, 1.817, 0.627)
"""Of the links [kg]. Approximate; the emulator itself has no dynamics."""
EFFORT = (87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0)


def urdf(robot: FrankaRobot) -> str:
    """The model as a URDF with the limits of velocity by position that libfranka reads.

    libfranka finds them by their names: `joint1` to `joint7`, and `link8` at the flange.
    """
    lines = ['<?xml version="1.0"?>', f'<robot name="{robot.name}">']
    lines.append('<link name="link0"/>')
    for joint, (a, d, alpha) in enumerate(kinematics.TABLE):
        xyz = kinematics.fixed(a, d, alpha)[:3, 3]
        lines += [_link(robot, joint + 1), _joint(robot, joint, xyz.tolist(), alpha)]
    lines += [
        '<link name="link8"/>',
        '<joint name="joint8" type="fixed">',
        f'<origin xyz="0 0 {kinematics.FLANGE}" rpy="0 0 0"/>',
        '<parent link="link7"/><child link="link8"/></joint>',
        "</robot>",
    ]
    return "\n".join(lines) + "\n"


def _link(robot: FrankaRobot, number: int) -> str:
    mass = MASSES[number - 1]
    return (
        f'<link name="link{number}"><inertial><mass value="{mass}"/>'
        '<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial></link>'
    )


def _joint(robot: FrankaRobot, joint: int, xyz: list[float], alpha: float) -> str:
    curve = robot.curves[joint]
    place = " ".join(f"{value:.9g}" for value in xyz)
    return (
        f'<joint name="joint{joint + 1}" type="revolute">'
        f'<origin xyz="{place}" rpy="{alpha:.15g} 0 0"/>'
        f'<parent link="link{joint}"/><child link="link{joint + 1}"/>'
        '<axis xyz="0 0 1"/>'
        f'<limit effort="{EFFORT[joint]}" lower="{curve.lower}" upper="{curve.upper}"'
        f' velocity="{robot.velocity[joint]}"/>'
        f'<position_based_velocity_limits velocity_offset="{curve.offset}"'
        f' deceleration_limit="{curve.fall / 2.0}"/></joint>'
    )
