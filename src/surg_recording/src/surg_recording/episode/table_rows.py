"""From messages to CSV rows, without ROS: a message is any object with these members.

A row is a tuple in the order of ``columns``; ``None`` becomes an empty field.
"""

from __future__ import annotations

import json
import math
from typing import Any

from surg_core.contract import SECOND_NS
from surg_recording.episode import table_columns

Row = tuple[Any, ...]

_CP = table_columns.COMMAND.index("x")
_JP = table_columns.COMMAND.index("yaw")
_CV = table_columns.COMMAND.index("vx")
_JV = table_columns.COMMAND.index("yaw_rate")
_JAW = table_columns.COMMAND.index("jaw")


def nanoseconds(stamp: Any) -> int:
    """A ROS time as integer nanoseconds."""
    return int(stamp.secs) * SECOND_NS + int(stamp.nsecs)


def _xyz(value: Any) -> tuple[float, float, float]:
    return value.x, value.y, value.z


def cycle(message: Any, receive_ns: int) -> Row:
    """One surg_msgs/Cycle as a row of ``columns.cycle``."""
    m = message
    return (
        nanoseconds(m.header.stamp),
        receive_ns,
        m.tick,
        m.state,
        int(m.homed),
        int(m.busy),
        m.reason,
        m.command,
        m.source,
        m.accepted,
        m.refused,
        *m.q,
        *m.qd,
        *m.p_goal,
        m.roll_goal,
        *m.p_tip,
        *m.s,
        *m.p_rcm,
        *m.q_br,
        m.roll,
        m.depth,
        m.rcm_error,
        *m.p_set,
        *m.v_set,
        m.roll_set,
        m.jaw_set,
        m.jaw,
        m.scale,
        m.limited_by,
        m.tier,
        *m.qd_command,
        *m.twist_command,
        m.compute_us,
        m.period_us,
        m.overruns,
    )


def ground_truth(stamp_ns: int, tick: int, arm: Any, receive_ns: int) -> Row:
    """One surg_msgs/ArmTruth as a row of ``columns.GROUND_TRUTH``."""
    return (
        stamp_ns,
        receive_ns,
        tick,
        *_xyz(arm.shaft_point),
        *_xyz(arm.shaft_axis),
        *_xyz(arm.tip),
        *_xyz(arm.tip_velocity),
        *_xyz(arm.trocar),
        *_xyz(arm.trocar_loaded),
        *_xyz(arm.trocar_force),
        arm.jaw,
    )


def task_state(message: Any, receive_ns: int) -> Row:
    """One surg_msgs/TaskState as a row of ``columns.task``."""
    m = message
    return (
        nanoseconds(m.header.stamp),
        receive_ns,
        m.tick,
        m.phase,
        int(m.done),
        int(m.success),
        m.reward,
        m.reason,
        *m.values,
    )


def clock_sync(message: Any, receive_ns: int) -> Row:
    """One surg_msgs/ClockSync as a row of ``columns.CLOCK_SYNC``; what is not known stays empty."""
    m = message
    return (
        nanoseconds(m.header.stamp),
        receive_ns,
        m.clock,
        m.port_state,
        m.offset if math.isfinite(m.offset) else None,
        m.path_delay if math.isfinite(m.path_delay) else None,
        m.grandmaster,
        int(m.in_step),
        m.problem,
    )


def command(topic: str, message: Any, source: str, receive_ns: int) -> Row:
    """A motion command as a row of ``columns.COMMAND``.

    Args:
        topic: name below the arm, e.g. ``servo_cp`` or ``jaw/servo_jp``; its ending decides how the
            message is read: ``_cp`` PoseStamped, ``_cv`` TwistStamped, ``_jp``, ``_jr`` and
            ``_jv`` JointState.
        message: the message as received.
        source: caller id of the sender.
        receive_ns: wall clock at reception.
    """
    row: list[Any] = [None] * len(table_columns.COMMAND)
    row[:4] = nanoseconds(message.header.stamp), receive_ns, topic, source
    if topic.startswith("jaw/"):
        row[_JAW : _JAW + 1] = list(message.position[:1]) or [None]
    elif topic.endswith("_cp"):
        pose = message.pose
        q = pose.orientation
        row[_CP : _CP + 7] = *_xyz(pose.position), q.x, q.y, q.z, q.w
    elif topic.endswith("_cv"):
        twist = message.twist
        row[_CV : _CV + 6] = *_xyz(twist.linear), *_xyz(twist.angular)
    elif topic.endswith(("_jp", "_jr")):
        row[_JP : _JP + 4] = _four(message.position)
    elif topic.endswith("_jv"):
        row[_JV : _JV + 4] = _four(message.velocity)
    return tuple(row)


def _four(values: Any) -> list[Any]:
    """The four virtual joints; a message of another length is recorded as far as it goes."""
    return (list(values) + [None] * 4)[:4]


def operating_state(message: Any) -> str:
    """A crtk_msgs/OperatingState as the text of an event."""
    return json.dumps(
        {
            "state": message.state,
            "is_homed": bool(message.is_homed),
            "is_busy": bool(message.is_busy),
        }
    )
