"""One condition for what a vendor's controller says of itself, with a sentence and a cure.

The link's own state is no part of it: an arm that could move reads READY here, and the link
(`robot_link`) says ACTIVE once it drives the arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum


class Condition(IntEnum):
    """Numbered as in surg_msgs/LinkStatus. The driver of an arm runs without ROS."""

    OFFLINE = 0
    OFF = 1
    BRAKED = 2
    READY = 3
    ACTIVE = 4
    GUIDED = 5
    SLOWED = 6
    STOPPED = 7
    ESTOP = 8
    BROKEN = 9


@dataclass(frozen=True)
class Reading:
    """What the robot says: its condition, why it does not move, what to do, and its speed.

    ``sentence`` is empty where nothing is wrong; ``speed_scaling`` is motion against command.
    """

    condition: Condition
    sentence: str = ""
    cure: str = ""
    speed_scaling: float = 1.0

    @property
    def text(self) -> str:
        """Sentence and cure, for `LinkStatus.fault`."""
        return ": ".join(part for part in (self.sentence, self.cure) if part)


START = "./surg robot CELL start"
OFFLINE = Reading(
    Condition.OFFLINE, "the robot does not answer", "check its power, its cable and its address"
)
READY = Reading(Condition.READY, "the robot is not started", START)
NOT_NUMBERS = Reading(Condition.BROKEN, "the joints are not numbers", "restart the robot")

FULL_SPEED = 0.999
"""A speed scaling below it is no rounding."""

RUNNING, BACKDRIVE = 7, 6
"""UR robot modes."""
_ON, _RECOVER = "./surg robot CELL on", "look for the cause, then ./surg robot CELL recover"
_UR_MODES = {
    -1: Reading(Condition.BROKEN, "the robot's controller does not run", "restart the robot"),
    0: Reading(Condition.BROKEN, "the arm is disconnected from its controller", "check its cable"),
    1: Reading(Condition.BROKEN, "the safety settings are not confirmed", "confirm on the pendant"),
    2: Reading(Condition.OFF, "the arm starts up", "wait"),
    3: Reading(Condition.OFF, "the arm is powered off", _ON),
    4: Reading(Condition.OFF, "the arm is being powered on", "wait, then " + _ON),
    5: Reading(Condition.BRAKED, "the brakes are on", _ON),
    BACKDRIVE: Reading(Condition.GUIDED, "the arm is back-driven by hand", "end the back-driving"),
    8: Reading(Condition.OFF, "the arm's firmware is being updated", "wait"),
}
_ESTOP = "release it, then " + _ON
_UR_SAFETY = {
    3: Reading(Condition.STOPPED, "protective stop", _RECOVER),
    4: Reading(Condition.BROKEN, "recovery mode", "move the arm back inside its limits by hand"),
    5: Reading(Condition.STOPPED, "safeguard stop", "close the safeguard, then " + START),
    6: Reading(Condition.ESTOP, "emergency stop of the system", _ESTOP),
    7: Reading(Condition.ESTOP, "emergency stop", _ESTOP),
    8: Reading(Condition.BROKEN, "safety violation", _RECOVER),
    9: Reading(Condition.BROKEN, "safety fault", _RECOVER),
    10: Reading(Condition.BROKEN, "joint identities are being checked", "see the pendant"),
    11: Reading(Condition.BROKEN, "undefined safety mode", "see the pendant"),
    12: Reading(Condition.STOPPED, "safeguard stop of the automatic mode", "close the safeguard"),
    13: Reading(Condition.STOPPED, "the three-position switch is released", "press it half-way"),
}
_NORMAL, _REDUCED = 1, 2
_PAUSED = Reading(
    Condition.STOPPED,
    "a program is paused on the robot",
    "stop it on the pendant, or by ./surg robot CELL stop",
)


def ur_reading(
    robot_mode: int,
    safety: int,
    limiter: float = 1.0,
    guided: bool = False,
    slider: float = 1.0,
    paused: bool = False,
) -> Reading:
    """What a UR controller's modes mean.

    Args:
        robot_mode: RTDE ``robot_mode``.
        safety: RTDE ``safety_status`` (or ``safety_mode``).
        limiter: RTDE ``speed_scaling``, 0 to 1: by how much the robot itself slows the arm down.
        guided: Whether a person guides the arm: free-drive.
        slider: RTDE ``target_speed_fraction``, 0 to 1: what a person has set.
        paused: Whether a program waits for a person to press play.
    """
    if safety in _UR_SAFETY:
        return _UR_SAFETY[safety]
    if safety not in (_NORMAL, _REDUCED):
        return Reading(Condition.BROKEN, f"unknown safety mode {safety}", "see the pendant")
    if robot_mode != RUNNING:
        unknown = Reading(Condition.BROKEN, f"unknown robot mode {robot_mode}", "see the pendant")
        return _UR_MODES.get(robot_mode, unknown)
    if guided:
        return Reading(Condition.GUIDED, "the arm is guided by hand", "end it, then " + START)
    if paused:
        return _PAUSED
    for share, what, cure in (
        (slider, "the speed slider is at", "set it to 100 %, and slow down by the cell's limits"),
        (limiter, "the robot limits its speed to", "look for the cause on the pendant"),
    ):
        if not share >= FULL_SPEED:
            sentence = f"{what} {100 * share:.0f} %"
            return Reading(Condition.SLOWED, sentence, cure, slider * limiter)
    warning = "the safety mode is reduced" if safety == _REDUCED else ""
    return Reading(Condition.READY, warning, speed_scaling=slider * limiter)


_FRANKA_MODES = {
    "other": Reading(Condition.BRAKED, "the brakes are on", "release them in Desk, activate FCI"),
    "guiding": Reading(Condition.GUIDED, "the arm is guided by hand", "end it, then " + START),
    "user_stopped": Reading(
        Condition.ESTOP, "user stop", "release the external activation device, then " + START
    ),
    "automatic_error_recovery": Reading(Condition.STOPPED, "the robot recovers", "wait"),
}


def franka_reading(mode: str, errors: Sequence[str], slow: str = "") -> Reading:
    """What a Franka's mode means.

    Args:
        mode: Name of libfranka's robot mode: ``idle``, ``move``, ``user_stopped``.
        errors: The library's names of the errors that are set.
        slow: A warning about the connection.
    """
    if mode == "reflex":
        return Reading(Condition.STOPPED, f"reflex: {', '.join(errors) or 'no error'}", _RECOVER)
    if mode in ("idle", "move"):
        return Reading(Condition.READY, slow)
    unknown = Reading(Condition.BROKEN, f"unknown robot mode {mode!r}", "see Desk")
    return _FRANKA_MODES.get(mode, unknown)
