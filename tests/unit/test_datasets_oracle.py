"""The real lerobot reads what we export: 0.3.3 the format 2.1, 0.4.4 the format 3.0.

Opt-in: `./surg test --tier oracle`. Each version has an environment of its own, made on first use
(needs the internet): 1.6 GB each, some minutes.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from helpers import datasets_synthetic, lerobot_venv
from helpers.datasets_synthetic import FRAME_NS
from helpers.recording_synthetic import Synthetic
from surg_recording import datasets
from surg_recording.datasets import ExportOptions

pytestmark = pytest.mark.oracle

READER = Path(__file__).parents[1] / "helpers" / "lerobot_reader.py"
VERSIONS = {"0.3.3": "lerobot_v21", "0.4.4": "lerobot_v30"}
IDENTITIES = [1, 2, 3]
"""Of the recordings, in the order of the dataset."""


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    root = tmp_path_factory.mktemp("recordings")
    return [datasets_synthetic.record(root / f"r{i}", i, 1.0 + 0.35 * i) for i in IDENTITIES]


def read(version: str, out: Path, tmp_path: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Facts and every frame, as the real lerobot gives them, in random order."""
    python = lerobot_venv.python(version)
    env = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    env.update(HF_HUB_OFFLINE="1", HF_HOME=str(tmp_path / "hf"), HF_DATASETS_OFFLINE="1")
    argv = [str(python), str(READER), str(out), "100000", "1"]
    done = subprocess.run(argv, env=env, capture_output=True, text=True, timeout=1800, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    versions, facts, *frames = [
        json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")
    ]
    assert versions["lerobot"] == version
    print(", ".join(f"{name} {value}" for name, value in versions.items()), file=sys.stderr)
    return facts, frames


def misplaced(frames: list[dict[str, Any]]) -> int:
    """Pictures that are not those of their time: a picture says its own (frame · 50 ms)."""
    wrong = 0
    for frame in frames:
        for camera, shown in enumerate(frame["pictures"].values()):
            own = [IDENTITIES[frame["episode"]], camera, frame["grid_ns"] // FRAME_NS]
            wrong += shown != own
    return wrong


@pytest.mark.parametrize("version", VERSIONS)
def test_lerobot_gives_every_frame_right(
    version: str, recordings: list[Path], tmp_path: Path
) -> None:
    options = ExportOptions(executor="serial", splits={"train": 1.0})
    out = tmp_path / "set"
    report = datasets.load(VERSIONS[version]).write(recordings, out, options)
    assert report.ok, report
    facts, frames = read(version, out, tmp_path)
    assert (facts["episodes"], facts["frames"], facts["fps"]) == (3, report.frames, 20)
    assert facts["robot"] == "ur5e"
    assert len(frames) == report.frames
    assert misplaced(frames) == 0
    what = Synthetic()
    for frame in frames:
        assert frame["index"] == frame["asked"]
        assert frame["task"] == "follow the path"
        assert frame["tool"] == "PSM1: grasper"
        assert frame["timestamp"] == pytest.approx(frame["frame"] / 20, abs=1e-6)
        what.seconds = 1.0 + 0.35 * IDENTITIES[frame["episode"]]
        expected = what.executed(frame["grid_ns"] * 1e-9)
        assert frame["state"][:3] == pytest.approx(list(expected), abs=1e-7)
    print(
        f"lerobot {version}: {len(frames)} frames, {2 * len(frames)} pictures, 0 misplaced",
        file=sys.stderr,
    )


@pytest.mark.parametrize("version", VERSIONS)
def test_lerobot_sees_that_pictures_are_late(
    version: str, recordings: list[Path], tmp_path: Path
) -> None:
    """The negative control: the same check must fail when all pictures are stamped a frame late."""
    late = []
    for number, folder in enumerate(recordings):
        late.append(datasets_synthetic.copy(folder, tmp_path / f"late{number}", note="late"))
        datasets_synthetic.shift_pictures(late[-1], FRAME_NS)
    options = ExportOptions(executor="serial", splits={"train": 1.0})
    assert datasets.load(VERSIONS[version]).write(late, tmp_path / "set", options).ok
    _, frames = read(version, tmp_path / "set", tmp_path)
    assert misplaced(frames) == 2 * len(frames) > 0
    print(f"lerobot {version}: shifted by a frame, all misplaced", file=sys.stderr)
