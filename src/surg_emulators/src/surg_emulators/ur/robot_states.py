"""Modes of a UR controller with the numbers of RTDE, and the bit fields made from them."""

from __future__ import annotations

from enum import IntEnum


class RobotMode(IntEnum):
    """RTDE's `robot_mode`."""

    NO_CONTROLLER = -1
    DISCONNECTED = 0
    CONFIRM_SAFETY = 1
    BOOTING = 2
    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5  # powered, the brakes are on
    BACKDRIVE = 6
    RUNNING = 7
    UPDATING_FIRMWARE = 8


class SafetyMode(IntEnum):
    """RTDE's `safety_mode`."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9


class Runtime(IntEnum):
    """RTDE's `runtime_state`: what the program does."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


MOVES = frozenset({SafetyMode.NORMAL, SafetyMode.REDUCED})
"""Safety modes in which a program may move the arm."""
EMERGENCY = frozenset({SafetyMode.SYSTEM_EMERGENCY_STOP, SafetyMode.ROBOT_EMERGENCY_STOP})
DEAD = EMERGENCY | {SafetyMode.VIOLATION, SafetyMode.FAULT}
"""Safety modes that cut the power of the motors."""

JOINT_RUNNING, JOINT_IDLE, JOINT_OFF, JOINT_VIOLATION, JOINT_BOOTING = 253, 255, 239, 252, 247


def joint_mode(robot: int, safety: int) -> int:
    """RTDE's `joint_mode` of every joint."""
    if safety == SafetyMode.VIOLATION:
        return JOINT_VIOLATION
    modes = {
        RobotMode.RUNNING: JOINT_RUNNING,
        RobotMode.IDLE: JOINT_IDLE,
        RobotMode.POWER_ON: JOINT_BOOTING,
    }
    return modes.get(RobotMode(robot) if -1 <= robot <= 8 else RobotMode.POWER_OFF, JOINT_OFF)


def robot_status_bits(powered: bool, program_runs: bool, freedrive: bool) -> int:
    """RTDE's `robot_status_bits`: power on, program running, free-drive button pressed."""
    return powered | program_runs << 1 | freedrive << 2


def safety_status_bits(safety: int) -> int:
    """RTDE's `safety_status_bits`."""
    order = (
        safety == SafetyMode.NORMAL,
        safety == SafetyMode.REDUCED,
        safety == SafetyMode.PROTECTIVE_STOP,
        safety == SafetyMode.RECOVERY,
        safety == SafetyMode.SAFEGUARD_STOP,
        safety == SafetyMode.SYSTEM_EMERGENCY_STOP,
        safety == SafetyMode.ROBOT_EMERGENCY_STOP,
        safety in EMERGENCY,
        safety == SafetyMode.VIOLATION,
        safety == SafetyMode.FAULT,
        safety not in MOVES,
    )
    return sum(bit << place for place, bit in enumerate(order))
