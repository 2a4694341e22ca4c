"""The motion of one arm, from its control cycles: state, goal and pose at the rows a grid needs.

A recording of half an hour has a million cycles, a grid uses some ten thousand of them. What
depends on all cycles (the turns of the roll, when a goal began) is computed from a few columns of
every row; all other columns are read at the used rows only.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from surg_core import WristGeometry
from surg_core.action_space import shaft_joints
from surg_core.contract import POSITION_STREAMS
from surg_core.transforms import multiply_quaternions, rotate_back, tip_quaternions
from surg_recording.datasets.frames.frame_grid import ArmCycles
from surg_recording.datasets.frames.resample import Grid, Stamps, around
from surg_recording.episode import table_columns
from surg_recording.episode.checked.long_table import TROCAR
from surg_recording.episode.checked.shaft_ends import GEOMETRY, shaft_ends, wrist_of
from surg_recording.episode.table import Table
from surg_recording.recording_errors import EpisodeError

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

POSE_COMMANDS = (1, 2, 5, 6, 9, 10, 11, 12)
"""Values of surg_msgs/Cycle.command whose goal is ``p_goal``; otherwise the set-point counts."""

SAME_WRIST = 1e-6
"""[m, rad] The wrist's lengths and turn do not differ by more during an episode."""

_VECTORS = [f"{name}_{axis}" for name in ("p_tip", "s", "p_set", "p_goal") for axis in "xyz"]


@dataclasses.dataclass(frozen=True)
class ArmMotion:
    """An arm at the M rows that a grid needs, with strictly increasing stamps."""

    name: str
    path: str
    """The file, for messages."""
    stamps: Stamps
    q: Array
    """(M, joints) [rad]."""
    qd: Array
    """(M, joints) [rad/s]."""
    state: Array
    """(M, S) ``contract.arm_state``, rcm frame; without columns if the arm is not commanded."""
    goal: Array
    """(M, T) targets as in ``surg_core.action_space``, rcm frame."""
    goal_since_ns: Stamps
    """(M,) stamp since which the goal of a row is in force."""
    p_BTip: Array
    q_BTool: Array
    q_BR: Array
    """(M, 4) orientation of the rcm frame in the base, x, y, z, w; without columns as ``state``."""
    wrist: WristGeometry | None = None
    """None: the instrument is straight, or the arm is not commanded."""

    def q_BR_at(self, times: Stamps) -> Array:
        """(K, 4) orientation of the rcm frame at the last of these rows before each time [ns]."""
        return self.q_BR[np.searchsorted(self.stamps, times, side="right") - 1]


def motion_of(arm: ArmCycles, grid: Grid) -> ArmMotion:
    """The rows for the grid times and for the times after each; EpisodeError as ``at``."""
    rows = around(arm.stamps, np.concatenate([grid.times_ns, grid.next_ns]))
    joints = [f"{p}{i}" for p in ("q", "qd") for i in range(arm.table.joints)]
    columns = [*_VECTORS, *TROCAR, "jaw", "jaw_set"] if arm.commanded else []
    if arm.commanded and arm.table.wristed:
        columns += ["depth", *(name for field in table_columns.WRIST for name in field.columns)]
    cycle = arm.table.at(arm.first + rows, [*joints, *columns])
    motion = ArmMotion(
        name=arm.name,
        path=str(arm.table.path),
        stamps=cycle["stamp_ns"],
        q=cycle.joints("q"),
        qd=cycle.joints("qd"),
        state=np.empty((len(rows), 0)),
        goal=np.empty((len(rows), 0)),
        goal_since_ns=cycle["stamp_ns"],
        p_BTip=np.empty((len(rows), 0)),
        q_BTool=np.empty((len(rows), 0)),
        q_BR=np.empty((len(rows), 0)),
    )
    if not arm.commanded:
        return motion
    posed = np.isin(arm.command, POSE_COMMANDS)
    roll = unwrapped(arm.column("roll"), rows)
    goals = np.where(posed, arm.column("roll_goal"), arm.column("roll_set"))
    began = np.flatnonzero(np.diff(arm.column("accepted"), prepend=-1) != 0)
    since = began[np.maximum(np.searchsorted(began, rows, side="right") - 1, 0)]
    q_BR, p_BTip = cycle.vector("q_br", "xyzw"), cycle.vector("p_tip")
    p_BRcm = cycle.vector("p_rcm")
    tip, p_set, goal = (
        rotate_back(q_BR, cycle.vector(name) - p_BRcm) for name in ("p_tip", "p_set", "p_goal")
    )
    p_action = np.where(posed[rows][:, None], goal, p_set)
    streams = np.isin(arm.command, POSITION_STREAMS)
    p_go_on = np.where(streams[rows][:, None], goal, p_set)
    roll_go_on = np.where(streams, arm.column("roll_goal"), arm.column("roll_set"))
    roll_action, roll_go_on = unwrapped(goals, rows), unwrapped(roll_go_on, rows)
    s_R = rotate_back(q_BR, cycle.vector("s"))
    motion = dataclasses.replace(
        motion,
        state=np.column_stack([tip, roll, cycle["jaw"], p_go_on, roll_go_on]),
        goal=np.column_stack([p_action, roll_action, cycle["jaw_set"]]),
        goal_since_ns=arm.stamps[since],
        p_BTip=p_BTip,
        q_BR=q_BR,
        q_BTool=multiply_quaternions(q_BR, tip_quaternions(s_R, roll)),
    )
    if not arm.table.wristed:
        return motion
    return _behind_a_wrist(motion, cycle, s_R, posed[rows], streams[rows])


def _behind_a_wrist(
    motion: ArmMotion, cycle: Table, s_R: Array, posed: Flags, streams: Flags
) -> ArmMotion:
    """The same arm with the joints of its wrist and the orientation of its tip.

    Args:
        motion: As of a straight instrument.
        cycle: The M rows.
        s_R: (M, 3) shaft axes.
        posed: (M,) whether the newest target is a pose.
        streams: (M,) whether it is a sample of a stream.
    """
    wrist, lengths = wrist_of(cycle), np.column_stack([cycle[name] for name in GEOMETRY])
    if np.ptp(lengths, axis=0).max() > SAME_WRIST:
        raise EpisodeError(f"{motion.path}: {', '.join(GEOMETRY)} change: homed twice?")

    def chosen(aimed: Flags) -> tuple[Array, Array, Array]:
        """End of the shaft, orientation of the tip, joints of the wrist: goal or set-point."""
        told = []
        for of in ("goal", "set"):
            end = rotate_back(motion.q_BR, shaft_ends(cycle, of) - cycle.vector("p_rcm"))
            turns = np.column_stack([cycle[f"wrist_{axis}_{of}"] for axis in ("pitch", "yaw")])
            told.append((end, cycle.vector(f"q_{of}", "xyzw"), turns))
        (end, q, turns), (end_set, q_set, turns_set) = told
        rows = aimed[:, None]
        return (
            np.where(rows, end, end_set),
            np.where(rows, q, q_set),
            np.where(rows, turns, turns_set),
        )

    roll, jaw = motion.state[:, 3], motion.state[:, 4]
    p_go_on, roll_go_on = motion.state[:, 5:8], motion.state[:, 8]
    q_tip = cycle.vector("q_tip", "xyzw")
    turned = np.column_stack([cycle["wrist_pitch"], cycle["wrist_yaw"]])
    measured = shaft_joints(cycle["depth"][:, None] * s_R)
    end_on, q_go_on, turns_on = chosen(streams)
    end, _, turns = chosen(posed)
    return dataclasses.replace(
        motion,
        wrist=wrist,
        state=np.column_stack(
            [
                *(motion.state[:, :3], q_tip, measured, roll, turned, jaw),
                *(p_go_on, q_go_on, shaft_joints(end_on), roll_go_on, turns_on),
            ]
        ),
        goal=np.column_stack([end, motion.goal[:, 3], turns, motion.goal[:, 4]]),
        q_BTool=multiply_quaternions(motion.q_BR, q_tip),
    )


def unwrapped(angles: Array, rows: Stamps) -> Array:
    """Some rows of ``np.unwrap(angles)`` [rad], with memory for one further array only."""
    turns = np.diff(angles)
    turns /= -2.0 * np.pi
    np.cumsum(np.rint(turns, out=turns), out=turns)
    counted = np.zeros(len(rows))
    counted[rows > 0] = turns[rows[rows > 0] - 1]
    return np.asarray(angles[rows] + 2.0 * np.pi * counted)
