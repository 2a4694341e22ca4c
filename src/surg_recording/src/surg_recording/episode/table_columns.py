"""Columns of the CSV tables of an episode, format version 1, and the kind of each.

The tables are written by ``rows`` and read by ``episode``; docs/reference/recording.md lists the
columns with
unit and frame. Vectors are in the arm's base frame unless the name or that page says otherwise.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable


def _xyz(prefix: str) -> list[str]:
    return [f"{prefix}_{axis}" for axis in "xyz"]


def _numbered(prefix: str, n: int) -> list[str]:
    return [f"{prefix}{i}" for i in range(n)]


def cycle(joints: int) -> list[str]:
    """Columns of ``cycle_<arm>.csv`` for an arm with this many joints."""
    return [
        *("stamp_ns", "receive_ns", "tick", "state", "homed", "busy", "reason"),
        *("command", "source", "accepted", "refused"),
        *_numbered("q", joints),
        *_numbered("qd", joints),
        *(*_xyz("p_goal"), "roll_goal", *_xyz("p_tip"), *_xyz("s"), *_xyz("p_rcm")),
        *("q_br_x", "q_br_y", "q_br_z", "q_br_w", "roll", "depth", "rcm_error"),
        *(*_xyz("p_set"), *_xyz("v_set"), "roll_set", "jaw_set", "jaw"),
        *("scale", "limited_by", "tier"),
        *_numbered("qd_command", joints),
        *_numbered("twist_command_", 6),
        *("compute_us", "period_us", "overruns"),
    ]


GROUND_TRUTH: list[str] = [
    *("stamp_ns", "receive_ns", "tick"),
    *(*_xyz("shaft"), *_xyz("axis"), *_xyz("tip"), "tip_vx", "tip_vy", "tip_vz"),
    *(*_xyz("trocar"), *_xyz("trocar_loaded"), *_xyz("force"), "jaw"),
]
"""Columns of ``ground_truth_<arm>.csv``."""

COMMAND: list[str] = [
    *("stamp_ns", "receive_ns", "topic", "source"),
    *("x", "y", "z", "qx", "qy", "qz", "qw"),
    *("yaw", "pitch", "insertion", "roll"),
    *("vx", "vy", "vz", "wx", "wy", "wz"),
    *("yaw_rate", "pitch_rate", "insertion_rate", "roll_rate", "jaw"),
]
"""Columns of ``command_<arm>.csv``; a command fills its own group and leaves the others empty."""

TASK: list[str] = [
    *("stamp_ns", "receive_ns", "tick", "phase", "done", "success", "reward", "reason"),
]
"""First columns of ``task_state.csv``; the task's own follow, see ``task``."""

TASK_PREFIX = "task."
"""Before the names of a task's numbers, so that they cannot be those of other columns."""


def task(names: Iterable[str]) -> list[str]:
    """Columns of ``task_state.csv`` for the names of a surg_msgs/TaskState.

    A number ``name`` has a column ``task.name``, an array ``name[2,3]`` has ``task.name_0_0``,
    ``task.name_0_1``, … row by row.

    Raises:
        ValueError: A name that is none of these.
    """
    found = list(TASK)
    for entry in names:
        match = _ENTRY.match(entry)
        if match is None:
            raise ValueError(f"a task's entry is called {entry!r}: name or name[n,m] is needed")
        name, shape = match.group(1), match.group(2)
        sizes = [range(int(size)) for size in shape.split(",")] if shape else []
        for place in itertools.product(*sizes):
            found.append(TASK_PREFIX + "_".join([name, *map(str, place)]))
    return found


EVENTS: list[str] = ["stamp_ns", "receive_ns", "topic", "source", "text"]
"""Columns of ``events.csv``."""

VIDEO: list[str] = ["frame", "stamp_ns", "receive_ns", "pts", "dropped"]
"""Columns of the sidecar ``<camera>.csv`` of a video."""

CLOCK_SYNC: list[str] = [
    *("stamp_ns", "receive_ns", "clock", "port_state", "offset_s", "path_delay_s"),
    *("grandmaster", "in_step", "problem"),
]
"""Columns of ``clock_sync.csv``: what the clock monitors say, once a second per machine."""

_INTEGERS = frozenset(
    (
        *("stamp_ns", "receive_ns", "tick", "state", "homed", "busy", "command", "accepted"),
        *("refused", "overruns", "tier", "frame", "pts", "dropped", "done", "success"),
        "in_step",
    )
)
_STRINGS = frozenset(
    (
        *("phase", "reason", "source", "limited_by", "topic", "text"),
        *("clock", "port_state", "grandmaster", "problem"),
    )
)
_ENTRY = re.compile(r"^([^\[\],]+)(?:\[(\d+(?:,\d+)*)\])?$")
_JOINT = re.compile(r"^q(\d+)$")


def kind(column: str) -> type:
    """What a column holds: ``int``, ``float`` or ``str``; unknown columns are numbers."""
    if column in _INTEGERS:
        return int
    return str if column in _STRINGS else float


def joint_count(names: list[str]) -> int:
    """How many joints a cycle table describes (columns q0, q1, …)."""
    return sum(1 for name in names if _JOINT.match(name))
