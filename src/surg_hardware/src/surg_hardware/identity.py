"""Whether the arm at the address is the one that the cell means."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from surg_hardware.checkup import Array, Finding
from surg_hardware.robot_adapter import ArmIdentity

if TYPE_CHECKING:
    import surg_core

FLANGE = "forward kinematics"
FLANGE_DISTANCE = 0.0005
"""[m] Between our flange and the robot's own: its factory kinematics differ by millimetres."""
FLANGE_ANGLE = math.radians(0.1)
"""[rad]"""
MASS, COG = 0.1, 0.02
"""[kg], [m] Tolerances of the payload that the robot has set."""
KINEMATICS = "check the model; then read the arm's own kinematics: ./surg robot CELL kinematics"


def of_cell(arm: surg_core.Arm) -> ArmIdentity:
    """What the cell says of a real or emulated arm; of its flange nothing."""
    hardware = arm.hardware
    if hardware is None:
        raise ValueError(f"{arm.name} has no 'hardware' in its cell")
    x, y, z = hardware.payload_cog.tolist()
    return ArmIdentity(arm.robot.name, (), hardware.serial, hardware.payload_mass, (x, y, z))


def mismatches(expected: ArmIdentity, found: ArmIdentity) -> list[Finding]:
    """Where the robot is not the one that the cell means, by the cell's keys; empty: it is."""
    wrong = []
    if found.serial is not None and found.serial != expected.serial:
        wrong.append(
            _bad(
                "hardware.serial",
                f"the cell says {expected.serial!r}, the robot is {found.serial!r}",
                "check address and serial; this is another arm",
            )
        )
    if not same_model(expected.model, found.model):
        wrong.append(
            _bad(
                "robot",
                f"the cell says {expected.model!r}, the robot is a {found.model!r}",
                "name the YAML of this model",
            )
        )
    if not abs(found.mass - expected.mass) <= MASS:
        wrong.append(
            _bad(
                "hardware.payload.mass",
                f"the cell says {expected.mass:g} kg, the robot has {found.mass:g} kg set; "
                f"allowed is a difference of {MASS:g} kg",
                "set it on the pendant",
            )
        )
    away = math.dist(expected.cog, found.cog)
    if not away <= COG:
        wrong.append(
            _bad(
                "hardware.payload.cog",
                f"the cell and the robot differ by {1e3 * away:.0f} mm; allowed is "
                f"{1e3 * COG:.0f} mm",
                "set it on the pendant",
            )
        )
    return wrong


def all_mismatches(arm: surg_core.Arm, q: Sequence[float], found: ArmIdentity) -> list[Finding]:
    """As `mismatches` of a cell's arm, and of its flange at these joint positions [rad]."""
    flange = flange_mismatch(arm.chain.forward(np.array(q)), rigid(found.flange))
    return mismatches(of_cell(arm), found) + ([flange] if flange is not None else [])


def findings(arm: surg_core.Arm, q: Sequence[float], found: ArmIdentity) -> list[Finding]:
    """Serial, model, payload and forward kinematics of a cell's arm, line by line.

    Args:
        arm: Of the cell.
        q: Joint positions [rad].
        found: What the robot says of itself there.
    """
    distance, angle = flange_difference(arm.chain.forward(np.array(q)), rigid(found.flange))
    x, y, z = found.cog
    lines = {
        "hardware.serial": found.serial or "unknown: the robot tells none",
        "robot": found.model,
        "hardware.payload.mass": f"{found.mass:g} kg",
        "hardware.payload.cog": f"[{x:g}, {y:g}, {z:g}] m",
        FLANGE: f"our flange differs by {1e3 * distance:.3f} mm, {math.degrees(angle):.3f} deg",
    }
    wrong = {each.what: each for each in all_mismatches(arm, q, found)}
    return [wrong.get(key, Finding(key, text)) for key, text in lines.items()]


def _bad(key: str, text: str, cure: str) -> Finding:
    return Finding(key, text, False, cure)


def same_model(ours: str, theirs: str) -> bool:
    """Whether a robot's name is of our model: ``UR5`` (as an e-Series says) is ``ur5e``."""
    name = theirs.strip().lower()
    return bool(name) and ours.lower() in (name, name + "e")


def flange_difference(ours: Array, theirs: Array) -> tuple[float, float]:
    """Distance [m] and angle [rad] between two flange poses (4, 4)."""
    distance = float(np.linalg.norm(ours[:3, 3] - theirs[:3, 3]))
    R = ours[:3, :3].T @ theirs[:3, :3]
    twice_sine = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return distance, math.atan2(float(np.linalg.norm(twice_sine)), float(np.trace(R)) - 1)


def flange_mismatch(ours: Array, theirs: Array) -> Finding | None:
    """The difference of two flange poses (4, 4) in the robot's base, if it is too large."""
    distance, angle = flange_difference(ours, theirs)
    if distance <= FLANGE_DISTANCE and angle <= FLANGE_ANGLE:
        return None
    return _bad(
        FLANGE,
        f"our flange is {1e3 * distance:.2f} mm and {math.degrees(angle):.2f} degrees from the "
        f"robot's own; allowed are {1e3 * FLANGE_DISTANCE:g} mm and "
        f"{math.degrees(FLANGE_ANGLE):g} degrees",
        KINEMATICS,
    )


def ur_pose(values: Sequence[float]) -> Array:
    """A UR pose, (x, y, z) [m] and rotation vector [rad], as a matrix (4, 4)."""
    pose = np.eye(4)
    pose[:3, 3] = values[:3]
    vector = np.array(values[3:6], dtype=np.float64)
    angle = float(np.linalg.norm(vector))
    if angle > 1e-12:
        x, y, z = vector / angle
        K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        pose[:3, :3] += math.sin(angle) * K + (1 - math.cos(angle)) * (K @ K)
    return pose


def ur_flange(tcp_pose: Sequence[float], tcp_offset: Sequence[float]) -> Array:
    """The flange in ROS's base_link (4, 4), from RTDE's ``actual_TCP_pose`` and ``tcp_offset``.

    ROS turns UR's own base by 180 degrees about z.
    """
    turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    flange: Array = turn @ ur_pose(tcp_pose) @ np.linalg.inv(ur_pose(tcp_offset))
    return flange


def ur_wrench(values: Sequence[float]) -> tuple[float, ...]:
    """RTDE's ``actual_TCP_force`` in ROS's base_link: force [N], torque [N m] (6,)."""
    fx, fy, fz, tx, ty, tz = values
    return -fx, -fy, fz, -tx, -ty, tz


def rigid(rows: Sequence[float]) -> Array:
    """A pose (4, 4) from its upper three rows, row by row (12,)."""
    pose = np.eye(4)
    pose[:3] = np.array(rows, dtype=np.float64).reshape(3, 4)
    return pose
