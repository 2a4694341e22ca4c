"""Errors of Franka's research interface, in the order of the flags in a robot state."""

from __future__ import annotations

from enum import IntEnum

FLAGS = 41
"""Flags in a state; those that are not named here are never raised by the emulator."""


class Error(IntEnum):
    """Number of an error's flag; the names are those that libfranka prints."""

    joint_position_limits_violation = 0
    cartesian_position_limits_violation = 1
    self_collision_avoidance_violation = 2
    joint_velocity_violation = 3
    cartesian_velocity_violation = 4
    force_control_safety_violation = 5
    joint_reflex = 6
    cartesian_reflex = 7
    joint_position_motion_generator_start_pose_invalid = 11
    joint_motion_generator_position_limits_violation = 12
    joint_motion_generator_velocity_limits_violation = 13
    joint_motion_generator_velocity_discontinuity = 14
    joint_motion_generator_acceleration_discontinuity = 15
    communication_constraints_violation = 25
    power_limit_violation = 26
    tau_j_range_violation = 34
    instability_detected = 35


class Violation(Exception):
    """A command that the arm does not execute.

    Args:
        error: The flag that it raises.
        text: What was wrong, for people.
    """

    def __init__(self, error: Error, text: str) -> None:
        super().__init__(text)
        self.error = error
