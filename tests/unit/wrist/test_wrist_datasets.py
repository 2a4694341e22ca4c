"""A recorded wristed episode, read by csv, pyarrow and h5py alone, is the simulator's truth."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import surg_core
from helpers.recording import wristed_episode
from helpers.recording.restated import restate
from helpers.recording.wristed_episode import ARM, OPTIONS, Truth
from surg_core.contract import ACTION_SPACES, TICK_NS, WRISTED_ACTION_SPACES
from surg_recording import datasets, episode
from surg_recording.metrics import unsafe_commands
from surg_recording.reports import run_series
from surg_sim.envs.cell_session import SOURCE

Array = NDArray[np.float64]
TURN = 2e-3
"""[rad] The encoders' noise turns the measured tool by less."""


def parquet(folder: Path) -> Any:
    """Rows of the only episode, and the names of its features."""
    (file,) = (folder / "data").glob("**/*.parquet")
    features = json.loads((folder / "meta/info.json").read_text())["features"]
    table = pq.read_table(file)
    return table, {name: feature["names"] for name, feature in features.items()}


def vectors(table: Any, name: str) -> Array:
    """(frames, D) of a column."""
    return np.array(table[name].to_pylist(), dtype=np.float64)


def apart(quaternions: Array, truth: Array) -> float:
    """Largest angle [rad] between quaternions x, y, z, w and rotations."""
    turned = Rotation.from_quat(quaternions).inv() * Rotation.from_matrix(truth)
    return float(turned.magnitude().max())


def test_every_cycle_holds_joints_and_orientations(recorded: tuple[Path, Truth]) -> None:
    folder, truth = recorded
    with (folder / f"cycle_{ARM}.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["homed"] == "1"]
    stamps = [int(row["stamp_ns"]) for row in rows]

    def columns(*names: str) -> Array:
        return np.array([[float(row[name]) for name in names] for row in rows])

    q_tip = columns(*(f"q_tip_{axis}" for axis in "xyzw"))
    tips = np.array([truth.tip[stamp] for stamp in stamps])
    assert apart(q_tip, tips[:, :3, :3]) < TURN
    told = columns("depth", "roll", "wrist_pitch", "wrist_yaw")
    measured = np.array([truth.measured_js[stamp] for stamp in stamps])
    np.testing.assert_array_equal(told, measured[:, 2:])
    q_set = columns(*(f"q_set_{axis}" for axis in "xyzw"))
    assert np.degrees(apart(q_set, tips[:, :3, :3])) < 15.0, "it follows"
    assert np.ptp(measured[:, 4:], axis=0).min() > 0.3, "the wrist turned"


def test_a_data_set_holds_the_true_orientation(
    recorded: tuple[Path, Truth], exported: dict[str, Path], tmp_path: Path
) -> None:
    truth = recorded[1]
    table, names = parquet(exported["absolute"])
    stamps = table["timing.grid_ns"].to_pylist()
    tips = np.array([truth.tip[stamp] for stamp in stamps])
    R_BR = wristed_episode.rcm_frame(recorded[0])
    pose = vectors(table, "observation.cartesian_state")
    assert apart(pose[:, 3:], R_BR @ tips[:, :3, :3]) < TURN
    state = vectors(table, "observation.state")
    place = {name: i for i, name in enumerate(names["observation.state"])}

    def named(*wanted: str) -> Array:
        return state[:, [place[f"{ARM}/{name}"] for name in wanted]]

    assert apart(named("tip_qx", "tip_qy", "tip_qz", "tip_qw"), tips[:, :3, :3]) < TURN
    assert np.abs(named("tip_x", "tip_y", "tip_z") - tips[:, :3, 3]).max() < 2e-4
    joints = named("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw")
    measured = np.array([truth.measured_js[stamp] for stamp in stamps])
    np.testing.assert_allclose(joints, measured, atol=4e-7)

    report = datasets.load("robomimic").write([recorded[0]], tmp_path / "robomimic", OPTIONS)
    assert report.ok, report.errors
    with h5py.File(tmp_path / "robomimic/demos.hdf5") as file:
        demo = file["data/demo_0"]
        np.testing.assert_array_equal(demo["obs/cartesian_state"][:], pose.astype(np.float32))
        np.testing.assert_array_equal(demo["actions"][:], vectors(table, "action"))


def test_a_bent_wrist_is_no_deviation_of_the_pivot(recorded: tuple[Path, Truth]) -> None:
    """The tip lies up to 19 mm beside the line of the shaft."""
    read = episode.read(recorded[0])
    assert run_series.load(read, ARM).rcm_kinematic.max() < 1e-4
    rules = unsafe_commands.examine(read, ARM)
    assert [rule.name for rule in rules if rule.cycles] == []
    (deviation,) = (rule.worst for rule in rules if rule.name == "RCM deviation")
    assert deviation is not None and deviation < 1e-4


def test_a_report_knows_the_tip_of_commanded_joints(
    recorded: tuple[Path, Truth], tmp_path: Path
) -> None:
    """The measured joints as if they had been commanded: the tips are the simulator's."""
    shutil.copytree(recorded[0], tmp_path / "episode")
    file = tmp_path / "episode" / f"command_{ARM}.csv"
    with file.open(newline="") as table:
        rows = list(csv.DictReader(table))
    names, true = ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw"), []
    sent = [row for row in rows if row["topic"] == "servo_cp"]
    for row in sent:
        stamp = int(row["stamp_ns"])
        joints = recorded[1].measured_js[stamp].tolist()
        row |= {"topic": "servo_jp"} | dict(zip(names, joints, strict=True))
        true.append(recorded[1].tip[stamp][:3, 3])
    sent[0]["insertion"] = "nan"  # such a command ends in a FAULT, and its report is wanted
    with file.open("w", newline="") as table:
        writer = csv.DictWriter(table, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    restate(tmp_path / "episode")
    run = run_series.load(episode.read(tmp_path / "episode"))
    R_BR = wristed_episode.rcm_frame(recorded[0])
    assert run.input_source == "servo_jp" and len(run.input) == len(true[1:]) > 100
    tips = (run.input - run.p_rcm[-1]) @ R_BR
    assert np.linalg.norm(tips - np.array(true[1:]), axis=1).max() < 3e-4


@pytest.mark.parametrize("space", ACTION_SPACES)
def test_the_action_spaces_are_named(exported: dict[str, Path], space: str) -> None:
    _, names = parquet(exported[space])
    assert names["action"] == [f"{ARM}/{name}" for name in WRISTED_ACTION_SPACES[space]]


def commands_of(space: str, rows: Array, before: Array) -> list[surg_core.MotionCommand]:
    """What the rows of an action space tell the arm, by their meaning alone.

    ``before``: pose x, y, z, qx, qy, qz, qw of the frame before the first.
    """
    made = []
    p, turned = before[:3].copy(), Rotation.from_quat(before[3:7])
    for row in rows:
        if space == "joint":
            servo = surg_core.Motion.SERVO_JP
            made.append(surg_core.MotionCommand(servo, SOURCE, joints=row[:4], wrist=row[4:6]))
            continue
        period = 0.05 if space == "velocity" else 1.0
        if space == "absolute":
            p, turned = row[:3], Rotation.from_quat(row[3:7])
        else:
            p = p + period * row[:3]
            turned = Rotation.from_rotvec(period * row[3:6]) * turned
        servo = surg_core.Motion.SERVO_CP
        made.append(surg_core.MotionCommand(servo, SOURCE, p=p, rotation=turned.as_quat()))
    return made


@pytest.mark.parametrize("space", ACTION_SPACES)
def test_the_exported_actions_lead_to_the_same_motion(
    recorded: tuple[Path, Truth], exported: dict[str, Path], space: str
) -> None:
    table, names = parquet(exported[space])
    state = dict(
        zip(names["observation.state"], vectors(table, "observation.state")[0], strict=True)
    )
    held = ("set_x", "set_y", "set_z", "set_qx", "set_qy", "set_qz", "set_qw")
    before = np.array([state[f"{ARM}/{name}"] for name in held])
    commands = commands_of(space, vectors(table, "action"), before)
    times = (np.array(table["timing.grid_ns"]) + TICK_NS).tolist()
    replayed = wristed_episode.replay(dict(zip(times, commands, strict=True)))
    stamps = range(times[0], times[-1], 10 * TICK_NS)
    meant = np.array([recorded[1].tip[stamp] for stamp in stamps])
    done = np.array([replayed.tip[stamp] for stamp in stamps])
    assert np.abs(done[:, :3, 3] - meant[:, :3, 3]).max() < 2e-5
    turned = Rotation.from_matrix(done[:, :3, :3] @ np.swapaxes(meant[:, :3, :3], 1, 2))
    assert turned.magnitude().max() < 1e-3
    assert np.ptp(done[:, :3, 3], axis=0).min() > 0.005, "it moved"
