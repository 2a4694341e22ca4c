"""Topics that public dVRK clients require and this arm does not support.

The classes ``arm`` and ``psm`` of these clients check at startup that every topic is connected, and
fail otherwise, even if they never use it. These tables provide the missing topics: commands are
ignored with a warning, feedback is sent once as invalid (stamp 0, as in CRTK) or not at all.
"""

from __future__ import annotations

from dataclasses import dataclass

QUIET = 1.0
"""[s] Shortest interval between two equal warnings."""


@dataclass(frozen=True)
class Command:
    """A command topic that is ignored."""

    topic: str  # relative to the arm, or to ``/system``
    type: str  # its ROS type
    why: str  # why it is ignored, and what to use instead


@dataclass(frozen=True)
class Feedback:
    """A feedback topic without a measurement."""

    topic: str  # relative to the arm
    type: str  # its ROS type
    # latched value: ``invalid`` (stamp 0), a number, or None: nothing is sent
    value: str | float | None = "invalid"


_FORCE = (
    "the arm obeys positions and velocities only: a force command could not keep the pivot; use "
    "servo_cp, servo_cv or move_cp"
)
_JAW = "the jaw obeys angles only: use jaw/servo_jp or jaw/move_jp"

COMMANDS = (
    Command(
        "free",
        "std_msgs/Empty",
        "an arm that is let go does not keep the pivot; use hold, or state_command 'disable'",
    ),
    Command("servo_jf", "sensor_msgs/JointState", _FORCE),
    Command("spatial/servo_cf", "geometry_msgs/WrenchStamped", _FORCE),
    Command("body/servo_cf", "geometry_msgs/WrenchStamped", _FORCE),
    Command("body/set_cf_orientation_absolute", "std_msgs/Bool", _FORCE),
    Command(
        "use_gravity_compensation",
        "std_msgs/Bool",
        "the robot compensates its own weight; there is nothing to switch",
    ),
    Command(
        "trajectory_j/set_ratio",
        "std_msgs/Float64",
        "speed limits come from the cell and only tighten: lower tip_velocity there, or send "
        "servo_cp at the speed you want",
    ),
    Command("jaw/servo_jf", "sensor_msgs/JointState", _JAW),
    Command(
        "emulate_tool_present",
        "std_msgs/Bool",
        "the instrument is the one that the cell names; change it there",
    ),
    Command(
        "set_tool_present",
        "std_msgs/Bool",
        "the instrument is the one that the cell names; change it there",
    ),
)

_POWER = "this system has no power switch: send 'enable' or 'disable' to <arm>/state_command"
_SOUND = "this system makes no sounds"

SYSTEM_COMMANDS = (
    Command("power_off", "std_msgs/Empty", _POWER),
    Command("power_on", "std_msgs/Empty", _POWER),
    Command("home", "std_msgs/Empty", "send 'home' to <arm>/state_command of each arm"),
    Command("set_volume", "std_msgs/Float64", _SOUND),
    Command("beep", "std_msgs/Float64MultiArray", _SOUND),
    Command("string_to_speech", "std_msgs/String", _SOUND),
)
"""Of the class ``system``."""

FEEDBACK = (
    Feedback("spatial/measured_cf", "geometry_msgs/WrenchStamped"),
    Feedback("body/measured_cf", "geometry_msgs/WrenchStamped"),
    Feedback("spatial/jacobian", "std_msgs/Float64MultiArray", None),
    Feedback("body/jacobian", "std_msgs/Float64MultiArray", None),
    Feedback("local/setpoint_cp", "geometry_msgs/PoseStamped"),
    Feedback("trajectory_j/ratio", "std_msgs/Float64", 1.0),
)


def answer(owner: str, command: Command, sender: str) -> str:
    """Warning for an ignored command of an arm or of the system."""
    return f"{owner}: {command.topic} from {sender} ignored: {command.why}"


class Throttle:
    """Limits equal warnings to one per `QUIET`."""

    def __init__(self) -> None:
        self._last: dict[str, float] = {}

    def passes(self, key: str, now: float) -> bool:
        """Whether a warning of this key may be sent; ``now`` on the steady clock [s]."""
        if now - self._last.get(key, -QUIET) < QUIET:
            return False
        self._last[key] = now
        return True
