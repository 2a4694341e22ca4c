"""Bags of a recorded wristed episode, read by ROS's own messages, are recording and truth."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import surg_core
from helpers.recording import bag_messages, wristed_episode
from helpers.recording.wristed_episode import ARM, CELL, OPTIONS, Truth
from surg_recording import datasets

Array = NDArray[np.float64]
ROUNDED = 1e-6
"""[m] or [rad] by which a 32-bit number of an export is off."""
TURN = 2e-3
"""[rad] The encoders' noise turns the measured tool by less."""


def pose(message: Any) -> tuple[Array, Rotation]:
    """Place and orientation of a stamped pose."""
    p, q = message.pose.position, message.pose.orientation
    return np.array([p.x, p.y, p.z]), Rotation.from_quat([q.x, q.y, q.z, q.w])


@pytest.mark.parametrize("format_name", bag_messages.FORMATS)
def test_a_bag_holds_joint_names_and_orientations(
    format_name: str, recorded: tuple[Path, Truth], tmp_path: Path
) -> None:
    folder, truth = recorded
    report = datasets.load(format_name).write([folder], tmp_path / "set", OPTIONS)
    assert report.ok, report.errors
    (file,) = (tmp_path / "set").glob("episode_000000*")
    with (folder / f"cycle_{ARM}.csv").open(newline="") as table:
        cycles = {int(row["stamp_ns"]): row for row in csv.DictReader(table)}
    with (folder / f"command_{ARM}.csv").open(newline="") as table:
        rows = [row for row in csv.DictReader(table) if row["topic"].endswith("servo_cp")]
    sent = {int(row["stamp_ns"]): row for row in rows}
    arm = surg_core.load_cell(CELL).arms[ARM]
    R_BR = Rotation.from_matrix(wristed_episode.rcm_frame(folder))
    seen = dict.fromkeys(("measured_js", "tool/measured_js", "measured_cp", "servo_cp"), 0)
    for topic, message, time_ns in bag_messages.read(format_name, file):
        kind = topic.removeprefix(f"/{ARM}/")
        if kind == "measured_js":
            assert message.name == [f"q{i}" for i in range(arm.chain.dof)]
            q = [float(cycles[time_ns][f"q{i}"]) for i in range(arm.chain.dof)]
            np.testing.assert_allclose(message.position, q, atol=ROUNDED)
        if kind == "tool/measured_js":
            assert message.name == ["pitch", "yaw", "jaw"], "as in the graph"
            told = [float(cycles[time_ns][name]) for name in ("wrist_pitch", "wrist_yaw", "jaw")]
            np.testing.assert_allclose(message.position, told, atol=ROUNDED)
        if kind == "measured_cp":
            turned = (
                pose(message)[1].inv() * R_BR * Rotation.from_matrix(truth.tip[time_ns][:3, :3])
            )
            assert turned.magnitude() < TURN
        if kind == "servo_cp":
            in_force = sent[max(stamp for stamp in sent if stamp <= time_ns)]
            q = [float(in_force[f"q{axis}"]) for axis in "xyzw"]
            assert (pose(message)[1].inv() * Rotation.from_quat(q)).magnitude() < ROUNDED
        if kind in seen:
            seen[kind] += 1
    assert min(seen.values()) > 100, seen
