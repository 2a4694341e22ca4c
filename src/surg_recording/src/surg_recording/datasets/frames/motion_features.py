"""The features of motion: measured state, forces, the camera's pose, actions, ground truth."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from surg_core.action_space import ActionSpace
from surg_core.contract import (
    ACTION_KEY,
    ARM_FORCE,
    ARM_FORCE_UNITS,
    FORCE_KEY,
    FORCE_TIMEOUT_NS,
    STATE_KEY,
    arm_state,
)
from surg_core.force.observed_force import PLACES
from surg_core.transforms import rotate_back
from surg_recording.calibration import calibration_record
from surg_recording.datasets import schema
from surg_recording.datasets.frames.arm_motion import ArmMotion
from surg_recording.datasets.frames.frame_columns import BEFORE, LINEAR, NEXT, Columns
from surg_recording.datasets.frames.resample import around, linear, previous, slerp
from surg_recording.datasets.layout import Layout
from surg_recording.episode.checked.checked_episode import CheckedEpisode
from surg_recording.episode.checked.long_table import LongTable


def motion(
    made: Columns, episode: CheckedEpisode, layout: Layout, arms: Mapping[str, ArmMotion]
) -> None:
    """All of them."""
    commanded = [arms[arm] for arm in layout.commanded]
    _observed_motion(made, commanded, list(arms.values()))
    if layout.forces:
        _measured_forces(made, episode, commanded)
    if layout.scope:
        _camera_pose(made, episode, arms[layout.scope])
    _actions(made, commanded)
    if episode.truth:
        _ground_truth(made, episode.truth)


def _observed_motion(made: Columns, commanded: list[ArmMotion], arms: list[ArmMotion]) -> None:
    """Measured values: joints of all arms, tips of those that are commanded and so homed."""
    grid, gap = made.grid, made.gap_ns
    states, poses = [], []
    state_names: list[str] = []
    units: list[str] = []
    for arm in commanded:
        both = np.column_stack([arm.state, arm.p_BTip])
        resampled, _ = linear(arm.stamps, both, grid.times_ns, arm.path, gap)
        quaternion, _ = slerp(arm.stamps, arm.q_BTool, grid.times_ns, arm.path, gap)
        columns, of_columns = arm_state(arm.wrist is not None)
        for at in (i for i, name in enumerate(columns) if name.endswith("_qx")):
            turn = arm.state[:, at : at + 4]
            resampled[:, at : at + 4] = slerp(arm.stamps, turn, grid.times_ns, arm.path, gap)[0]
        states.append(resampled[:, : arm.state.shape[1]])
        poses.append(np.column_stack([resampled[:, arm.state.shape[1] :], quaternion]))
        state_names += [f"{arm.name}/{name}" for name in columns]
        units += of_columns
    names = [arm.name for arm in commanded]
    made.vector(
        STATE_KEY,
        np.hstack(states),
        tuple(state_names),
        tuple(units),
        "rcm frame of each arm",
        LINEAR,
        "measured tip, roll and jaw (and joints of a wrist); set-point of tip and roll",
    )
    made.vector(
        "observation.cartesian_state",
        np.hstack(poses),
        arm_names(names, schema.POSE),
        schema.POSE_UNITS * len(names),
        "base frame of each arm",
        "linear interpolation; slerp",
        "measured pose of the tool: tip and orientation (quaternion x, y, z, w)",
    )
    for kind, prefix, unit in (("positions", "q", "rad"), ("velocities", "qd", "rad/s")):
        values, flat = [], []
        for arm in arms:
            measured = arm.q if prefix == "q" else arm.qd
            resampled, before = linear(arm.stamps, measured, grid.times_ns, arm.path, gap)
            values.append(resampled)
            flat += [f"{arm.name}/{prefix}{i}" for i in range(resampled.shape[1])]
            if prefix == "q":
                text = f"cycle of {arm.name} before this frame"
                made.timing(arm.name, arm.stamps, before, grid.times_ns, text)
        if not flat:
            continue  # of another program, which recorded no joints
        made.vector(
            f"observation.joint_{kind}",
            np.hstack(values),
            tuple(flat),
            (unit,) * len(flat),
            "",
            LINEAR,
            f"measured joint {kind}",
        )


def _measured_forces(made: Columns, episode: CheckedEpisode, arms: list[ArmMotion]) -> None:
    """Forces at tip and trocar: the newest measured before each frame, if it is fresh."""
    times, parts = made.grid.times_ns, []
    for arm in arms:
        for place in PLACES:
            table = episode.forces[place, arm.name]
            values = np.zeros((len(times), 4))
            if table is not None:
                row = np.searchsorted(table["stamp_ns"], times, side="left") - 1
                known = (row >= 0) & (table["known"][row] == 1)
                known &= times - table["stamp_ns"][row] <= FORCE_TIMEOUT_NS
                force = table.vector("force")[row]
                turned = rotate_back(arm.q_BR_at(times), force)
                values = np.where(known[:, None], np.column_stack([turned, known]), 0.0)
            parts.append(values)
    names = [arm.name for arm in arms]
    made.vector(
        FORCE_KEY,
        np.hstack(parts),
        arm_names(names, ARM_FORCE),
        ARM_FORCE_UNITS * len(names),
        "rcm frame of each arm",
        BEFORE,
        "force on the tip and of the shaft on the trocar; known: 1, or 0 and no force",
    )


def _camera_pose(made: Columns, episode: CheckedEpisode, arm: ArmMotion) -> None:
    """The pose of the left camera, from the joints of the arm that holds it."""
    held = calibration_record.endoscope_of(episode.folder, episode.manifest)
    assert held is not None
    q, _ = linear(arm.stamps, arm.q, made.grid.times_ns, arm.path, made.gap_ns)
    made.vector(
        schema.CAMERA_POSE,
        calibration_record.camera_poses(held, q),
        schema.POSE,
        schema.POSE_UNITS,
        "world",
        LINEAR,
        "pose X_WV of the left camera (x right, y down, z away), by joints and calibration",
    )


_SPACES = {
    "absolute": "where tip, roll and jaw shall be at the next frame; absolute",
    "relative": "change of the command for tip and roll from this frame to the next; jaw absolute",
    "velocity": "the same change per second: mean velocity of the command; jaw absolute",
    "joint": "where tip, roll and jaw shall be at the next frame, as joints of the instrument",
}
"""Description of the action, by action space."""


def _actions(made: Columns, arms: list[ArmMotion]) -> None:
    """The commands in force at the next grid times, in the action space of the export."""
    grid, goals, before = made.grid, [], []
    for arm in arms:
        what = f"commands of {arm.name}"
        row = previous(arm.stamps, grid.next_ns, what)
        goals.append(arm.goal[row])
        before.append(arm.goal[previous(arm.stamps, grid.times_ns, what)])
        text = f"cycle that accepted the action of {arm.name}"
        made.timing(f"{arm.name}.action", arm.goal_since_ns, row, grid.next_ns, text)
    names = [arm.name for arm in arms]
    space = ActionSpace(made.options.action_space, tuple(arm.wrist for arm in arms))
    made.vector(
        ACTION_KEY,
        space.encode(np.hstack(goals), np.hstack(before), 1.0 / grid.fps),
        space.columns(names),
        space.units(names),
        "rcm frame of each arm",
        NEXT,
        f"{_SPACES[space.name]} (action space: {space.name})",
    )


def _ground_truth(made: Columns, truth: Mapping[str, LongTable]) -> None:
    """The simulator's tip, and its force of the shaft on the trocar, of each arm."""
    parts, names = [], []
    columns = [f"{name}_{axis}" for name in ("tip", "force") for axis in "xyz"]
    for arm, long in truth.items():
        table = long.at(around(long.index["stamp_ns"], made.grid.times_ns), columns)
        values = np.column_stack([table.vector("tip"), table.vector("force")])
        what = f"ground_truth_{arm}.csv"
        resampled, _ = linear(table["stamp_ns"], values, made.grid.times_ns, what, made.gap_ns)
        parts.append(resampled)
        names += [f"{arm}/{name}_{axis}" for name in ("tip", "force") for axis in "xyz"]
    made.vector(
        schema.GROUND_TRUTH,
        np.hstack(parts),
        tuple(names),
        ("m", "m", "m", "N", "N", "N") * len(truth),
        "base frame of each arm",
        LINEAR,
        "the simulator's tip, and the force of the shaft on the trocar's wall",
        privileged=True,
    )


def arm_names(arms: list[str], names: tuple[str, ...]) -> tuple[str, ...]:
    """``<arm>/<name>`` of all, arm by arm."""
    return tuple(f"{arm}/{name}" for arm in arms for name in names)
