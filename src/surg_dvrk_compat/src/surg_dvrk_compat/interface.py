"""The topics of a public dVRK client that this arm has no command or measurement behind.

A client of the classes ``arm`` and ``psm`` checks at its start that each of its publishers has a
listener and each of its subscriptions a sender, and gives up otherwise. So a script that never uses
forces would fail for want of a force topic. These tables fill the gap: commands are answered in
words and change nothing, feedback is sent once as invalid (stamp 0, as CRTK has it) or not at all.
"""

from __future__ import annotations

from dataclasses import dataclass

QUIET = 1.0
"""Shortest time between two equal warnings [s]."""


@dataclass(frozen=True)
class Command:
    """A topic that a client publishes and nobody obeys.

    Attributes:
        topic: Relative to the arm.
        type: Its ROS type.
        why: Why the arm does not do it, and what to do instead.
    """

    topic: str
    type: str
    why: str


@dataclass(frozen=True)
class Feedback:
    """A topic that a client subscribes and nothing is measured for.

    Attributes:
        topic: Relative to the arm.
        type: Its ROS type.
        value: What is sent once and latched: ``invalid`` (stamp 0), a number, or None: nothing.
    """

    topic: str
    type: str
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

FEEDBACK = (
    Feedback("spatial/measured_cf", "geometry_msgs/WrenchStamped"),
    Feedback("body/measured_cf", "geometry_msgs/WrenchStamped"),
    Feedback("spatial/jacobian", "std_msgs/Float64MultiArray", None),
    Feedback("body/jacobian", "std_msgs/Float64MultiArray", None),
    Feedback("local/setpoint_cp", "geometry_msgs/PoseStamped"),
    Feedback("trajectory_j/ratio", "std_msgs/Float64", 1.0),
)


def answer(arm: str, command: Command, sender: str) -> str:
    """What is said to a command that nobody obeys."""
    return f"{arm}: {command.topic} from {sender} ignored: {command.why}"


class Throttle:
    """Lets one of many equal things through per second."""

    def __init__(self) -> None:
        self._last: dict[str, float] = {}

    def passes(self, key: str, now: float) -> bool:
        """Whether ``key`` may be said at ``now`` [s of any steady clock]."""
        if now - self._last.get(key, -QUIET) < QUIET:
            return False
        self._last[key] = now
        return True
