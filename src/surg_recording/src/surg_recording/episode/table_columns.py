"""The fields of an episode's CSV tables, format version 1: columns, kinds, units and sources.

Everything that lists fields is derived from these tables: the headers of the CSV files, the rows
(``table_rows``), the kinds with which ``episode_reader`` reads them, and the messages of episodes
that are played without ROS (``surg_sim.envs.episode_messages``). Vectors are in the arm's base
frame unless docs/reference/recording.md says otherwise.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable
from dataclasses import dataclass

from surg_core.contract import WRISTED_JOINTS


@dataclass(frozen=True)
class Field:
    """One field of a message and the columns it fills.

    Attributes:
        source: Attribute of the message, with dots; empty: not from the message.
        columns: Names of its columns; ``{}`` stands for the number of a joint.
        kind: Type of the columns: ``int``, ``float`` or ``str``.
        unit: SI; empty for numbers without a unit and for texts.
        members: Attributes of the value, one per column; empty: a scalar, or an array.
        truth_value: A bool, recorded as 0 or 1.
        optional: A non-finite number leaves the column empty.
        first: Only the first value of the array is recorded.
    """

    source: str
    columns: tuple[str, ...]
    kind: type = float
    unit: str = ""
    members: tuple[str, ...] = ()
    truth_value: bool = False
    optional: bool = False
    first: bool = False

    @property
    def per_joint(self) -> bool:
        """Whether there is one column per joint."""
        return "{}" in self.columns[0]

    @property
    def is_array(self) -> bool:
        """Whether the value is an array without member names."""
        return self.first or (not self.members and (self.per_joint or len(self.columns) > 1))

    @property
    def is_scalar(self) -> bool:
        """Whether the value is recorded unchanged, in one column."""
        plain = not (self.members or self.truth_value or self.optional)
        return plain and not self.is_array

    def expanded(self, joints: int) -> tuple[str, ...]:
        """Names of the columns for an arm with this many joints."""
        if not self.per_joint:
            return self.columns
        return tuple(self.columns[0].format(i) for i in range(joints))


Fields = tuple[Field, ...]


def _scalar(source: str, unit: str = "", kind: type = float) -> Field:
    return Field(source, (source,), kind, unit)


def _flag(source: str) -> Field:
    return Field(source, (source,), int, truth_value=True)


def _array(source: str, unit: str = "", axes: str = "xyz") -> Field:
    return Field(source, tuple(f"{source}_{axis}" for axis in axes), unit=unit)


def _joints(source: str, unit: str) -> Field:
    return Field(source, (source + "{}",), unit=unit)


def _point(source: str, columns: Iterable[str], unit: str) -> Field:
    return Field(source, tuple(columns), unit=unit, members=("x", "y", "z"))


_STAMPS: Fields = (Field("", ("stamp_ns",), int, "ns"), Field("", ("receive_ns",), int, "ns"))
"""First columns of every table of messages: the header's stamp, and when it was received."""

_TICK = _scalar("tick", kind=int)

CYCLE: Fields = (
    *_STAMPS,
    _TICK,
    _scalar("state", kind=int),
    _flag("homed"),
    _flag("busy"),
    _scalar("reason", kind=str),
    _scalar("command", kind=int),
    _scalar("source", kind=str),
    _scalar("accepted", kind=int),
    _scalar("refused", kind=int),
    _joints("q", "rad"),
    _joints("qd", "rad/s"),
    _array("p_goal", "m"),
    _scalar("roll_goal", "rad"),
    _array("p_tip", "m"),
    _array("s"),
    _array("p_rcm", "m"),
    _array("q_br", axes="xyzw"),
    _scalar("roll", "rad"),
    _scalar("depth", "m"),
    _scalar("rcm_error", "m"),
    _scalar("stop_bound_tip", "m"),
    _scalar("stop_bound_pivot", "m"),
    _array("p_set", "m"),
    _array("v_set", "m/s"),
    _scalar("roll_set", "rad"),
    _scalar("jaw_set", "rad"),
    _scalar("jaw", "rad"),
    _scalar("scale"),
    _scalar("limited_by", kind=str),
    _scalar("tier", kind=int),
    _joints("qd_command", "rad/s"),
    Field("twist_command", tuple(f"twist_command_{i}" for i in range(6)), unit="m/s, rad/s"),
    _scalar("compute_us", "us"),
    _scalar("period_us", "us"),
    _scalar("overruns", kind=int),
)


def _turn(source: str, columns: tuple[str, str]) -> Field:
    return Field(source, columns, unit="rad")


WRIST: Fields = (
    Field(
        "wrist_geometry",
        ("wrist_pitch_to_yaw", "wrist_yaw_to_tip", "wrist_turn"),
        unit="m, m, rad",
    ),
    _turn("wrist", ("wrist_pitch", "wrist_yaw")),
    _turn("wrist_set", ("wrist_pitch_set", "wrist_yaw_set")),
    _turn("wrist_goal", ("wrist_pitch_goal", "wrist_yaw_goal")),
    *(_array(name, axes="xyzw") for name in ("q_tip", "q_set", "q_goal")),
)
"""Further fields of surg_msgs/Cycle, of an arm whose instrument has a wrist."""

ARM_TRUTH: Fields = (
    *_STAMPS,
    Field("", ("tick",), int),
    _point("shaft_point", ("shaft_x", "shaft_y", "shaft_z"), "m"),
    _point("shaft_axis", ("axis_x", "axis_y", "axis_z"), ""),
    _point("tip", ("tip_x", "tip_y", "tip_z"), "m"),
    _point("tip_velocity", ("tip_vx", "tip_vy", "tip_vz"), "m/s"),
    _point("trocar", ("trocar_x", "trocar_y", "trocar_z"), "m"),
    _point("trocar_loaded", ("trocar_loaded_x", "trocar_loaded_y", "trocar_loaded_z"), "m"),
    _point("trocar_force", ("force_x", "force_y", "force_z"), "N"),
    _scalar("jaw", "rad"),
)
"""surg_msgs/ArmTruth, after stamp and tick of the surg_msgs/GroundTruth that it is in."""

FORCE: Fields = (
    *_STAMPS,
    Field("", ("known",), int),
    _point("wrench.force", ("force_x", "force_y", "force_z"), "N"),
)
"""geometry_msgs/WrenchStamped of a force sensor; without ``known`` the force is empty."""

TASK_STATE: Fields = (
    *_STAMPS,
    _TICK,
    _scalar("phase", kind=str),
    _flag("done"),
    _flag("success"),
    _scalar("reward"),
    _scalar("reason", kind=str),
)
"""surg_msgs/TaskState; the task's own numbers follow, see ``task``."""

CLOCK: Fields = (
    *_STAMPS,
    _scalar("clock", kind=str),
    _scalar("port_state", kind=str),
    Field("offset", ("offset_s",), unit="s", optional=True),
    Field("path_delay", ("path_delay_s",), unit="s", optional=True),
    _scalar("grandmaster", kind=str),
    _flag("in_step"),
    _scalar("problem", kind=str),
)

COMMAND_FIELDS: dict[str, Fields] = {
    "_cp": (
        _point("pose.position", "xyz", "m"),
        Field("pose.orientation", ("qx", "qy", "qz", "qw"), members=("x", "y", "z", "w")),
    ),
    "_jp": (Field("position", WRISTED_JOINTS, unit="rad; m"),),
    "_cv": (
        _point("twist.linear", ("vx", "vy", "vz"), "m/s"),
        _point("twist.angular", ("wx", "wy", "wz"), "rad/s"),
    ),
    "_jv": (
        Field("velocity", tuple(f"{name}_rate" for name in WRISTED_JOINTS), unit="rad/s; m/s"),
    ),
    "jaw/": (Field("position", ("jaw",), unit="rad", first=True),),
}
"""Fields that a motion command fills, by the ending of its topic; the jaw's by its beginning."""
COMMAND_FIELDS["_jr"] = COMMAND_FIELDS["_jp"]

_COMMANDS: Fields = (
    *_STAMPS,
    Field("", ("topic",), str),
    Field("", ("source",), str),
    *itertools.chain.from_iterable(COMMAND_FIELDS[key] for key in ("_cp", "_jp", "_cv", "_jv")),
    *COMMAND_FIELDS["jaw/"],
)
_EVENTS: Fields = (*_STAMPS, *(Field("", (name,), str) for name in ("topic", "source", "text")))
_VIDEO: Fields = tuple(
    Field("", (name,), int) for name in ("frame", "stamp_ns", "receive_ns", "pts", "dropped")
)


def _columns(fields: Fields, joints: int = 0) -> list[str]:
    return [name for each in fields for name in each.expanded(joints)]


def cycle(joints: int, wristed: bool = False) -> list[str]:
    """Columns of ``cycle_<arm>.csv`` for an arm with this many joints."""
    return _columns(CYCLE, joints) + (_columns(WRIST) if wristed else [])


GROUND_TRUTH: list[str] = _columns(ARM_TRUTH)
"""Columns of ``ground_truth_<arm>.csv``."""

MEASURED_FORCE: list[str] = _columns(FORCE)
"""Columns of ``tip_force_<arm>.csv`` and ``trocar_force_<arm>.csv``."""

COMMAND: list[str] = _columns(_COMMANDS)
"""Columns of ``command_<arm>.csv``; a command fills its own group and leaves the others empty."""

TASK: list[str] = _columns(TASK_STATE)
"""First columns of ``task_state.csv``; the task's own follow, see ``task``."""

EVENTS: list[str] = _columns(_EVENTS)

VIDEO: list[str] = _columns(_VIDEO)
"""Columns of the sidecar ``<camera>.csv`` of a video."""

CLOCK_SYNC: list[str] = _columns(CLOCK)
"""Columns of ``clock_sync.csv``: status of the clock monitors, once a second per machine."""

TASK_PREFIX = "task."
"""Before the names of a task's numbers, so that they cannot be those of other columns."""

_KINDS: dict[str, type] = {
    name: each.kind
    for table in (CYCLE, ARM_TRUTH, FORCE, TASK_STATE, CLOCK, _COMMANDS, _EVENTS, _VIDEO)
    for each in table
    for name in each.columns
}
_ENTRY = re.compile(r"^([^\[\],]+)(?:\[(\d+(?:,\d+)*)\])?$")
_JOINT = re.compile(r"^q(\d+)$")


def task(names: Iterable[str]) -> list[str]:
    """Columns of ``task_state.csv`` for the names of a surg_msgs/TaskState.

    A number ``name`` has a column ``task.name``, an array ``name[2,3]`` has ``task.name_0_0``,
    ``task.name_0_1``, … row by row; any other name is a ValueError.
    """
    columns = list(TASK)
    for entry in names:
        match = _ENTRY.match(entry)
        if match is None:
            raise ValueError(f"a task's entry is called {entry!r}; allowed: name or name[n,m]")
        name, shape = match.group(1), match.group(2)
        sizes = [range(int(size)) for size in shape.split(",")] if shape else []
        for place in itertools.product(*sizes):
            columns.append(TASK_PREFIX + "_".join([name, *map(str, place)]))
    return columns


def kind(column: str) -> type:
    """Type of a column: ``int``, ``float`` or ``str``; unknown columns are numbers."""
    return _KINDS.get(column, float)


def joint_count(names: list[str]) -> int:
    """Number of joints of a cycle table (columns q0, q1, …)."""
    return sum(1 for name in names if _JOINT.match(name))
