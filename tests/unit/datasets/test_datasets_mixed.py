"""One data set of several tasks, robots and instruments: chosen columns, equal in all."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from helpers.recording import datasets_synthetic
from helpers.recording.recording_synthetic import path
from surg_recording import datasets
from surg_recording.datasets import ExportError, ExportOptions

SECONDS = 0.7
KEEP = ("observation.state", "observation.images.endoscope.left", "timing.grid_ns", "next.*")


def options(**more: object) -> ExportOptions:
    return ExportOptions(executor="serial", **more)


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Another robot, another task, one camera less."""
    root, record = tmp_path_factory.mktemp("recordings"), datasets_synthetic.record
    other = record(root / "two", 2, SECONDS + 0.1, robot="panda")
    task = record(root / "three", 3, SECONDS + 0.2, cameras=("endoscope_left",))
    run = json.loads((task / "manifest.json").read_text())["run"]
    datasets_synthetic.edit(task, run={**run, "instruction": "fetch the bead"})
    return [record(root / "one", 1, SECONDS), other, task]


def test_without_columns_the_others_are_refused_with_the_cure(
    recordings: list[Path], tmp_path: Path
) -> None:
    report = datasets.load("lerobot_v30").write(recordings, tmp_path / "out", options())
    assert report.recordings == 1 and len(report.refused) == 2
    assert all("--columns" in why for why in report.refused.values()), report.refused


def test_chosen_columns_join_what_differs_and_name_it(
    recordings: list[Path], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    report = datasets.load("lerobot_v30").write(recordings, out, options(columns=KEEP))
    assert report.ok and report.recordings == 3 and not report.refused, (report, report.errors)
    mixed = report.facts["mixed"]
    assert "ur5e (2), panda (1)" in mixed["robots"] and "fetch the bead (1)" in mixed["task"]
    info = json.loads((out / "meta" / "info.json").read_text())
    assert info["robot_type"] == "ur5e|panda" and info["total_tasks"] == 2
    names = set(info["features"])
    assert {"action", "observation.state", "observation.images.endoscope.left"} <= names
    assert not {"observation.joint_positions", "observation.images.endoscope.right"} & names
    # Each row is the state of its own recording at its own time.
    table = pq.read_table(out / "data")
    for episode, grid_ns, action in zip(
        table["episode_index"].to_pylist(),
        table["timing.grid_ns"].to_pylist(),
        table["action"].to_pylist(),
        strict=True,
    ):
        after = grid_ns + datasets_synthetic.FRAME_NS
        if after < (50 + round((SECONDS + 0.1 * episode) / 0.002)) * 2_000_000:
            np.testing.assert_allclose(action[:3], path(after * 1e-9), atol=1e-6)


def test_a_column_that_differs_is_named_and_costs_its_recording_only(
    recordings: list[Path], tmp_path: Path
) -> None:
    """A picture of another size has the same name, and does not fit."""
    small = datasets_synthetic.record(tmp_path / "small", 5, SECONDS + 0.3, size=(60, 48))
    chosen = options(columns=KEEP)
    episodes = [*recordings, small]
    dry = datasets.dry_run(datasets.load("lerobot_v30"), episodes, chosen, lambda *_: None)
    report = datasets.load("lerobot_v30").write(episodes, tmp_path / "out", chosen)
    for each in (dry, report):
        assert each.recordings == 3 and list(each.refused) == [str(small)], each.refused
        assert "observation.images.endoscope.left: shape 48, 60, 3, not" in each.refused[str(small)]


def test_a_column_that_nobody_has_is_refused(recordings: list[Path], tmp_path: Path) -> None:
    with pytest.raises(ExportError, match=r"observation\.torque: no such feature"):
        chosen = options(columns=("observation.torque",))
        datasets.load("lerobot_v30").write(recordings, tmp_path / "out", chosen)
