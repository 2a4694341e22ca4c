"""A thousand short episodes through Dask, beside the real lerobot's own writer.

Opt-in: `./surg test --tier oracle`; with `--full` written to docs/results/datasets.md.
"""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from helpers.recording import datasets_synthetic
from helpers.recording.oracle_reading import run
from helpers.results.dataset_results import note
from surg_recording import datasets
from surg_recording.datasets import ExportOptions

pytestmark = pytest.mark.oracle

VERSION = "0.6.1"
WORKERS = 2
MOST_MIB = 300.0
"""Of memory, of each worker."""


def peak_mib() -> float:
    """Most memory that this process has had."""
    said = Path("/proc/self/status").read_text("ascii")
    return int(said.partition("VmHWM:")[2].split()[0]) / 1024


def test_a_thousand_episodes_beside_lerobots_writer(tmp_path: Path, full: bool) -> None:
    distributed = pytest.importorskip("distributed", reason="missing: python3-distributed")
    count = 1000 if full else 10
    first = datasets_synthetic.record(tmp_path / "r0", 1, 0.4, ("endoscope_left",))
    folders = [first] + [
        datasets_synthetic.copy(first, tmp_path / f"r{i}", seed=100 + i) for i in range(1, count)
    ]
    with (
        distributed.LocalCluster(
            n_workers=WORKERS, threads_per_worker=1, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        options = ExportOptions(
            executor="dask", scheduler=cluster.scheduler_address, splits={"train": 1.0}
        )
        began = time.monotonic()
        report = datasets.load("lerobot_v30").write(folders, tmp_path / "set", options)
        ours_s = time.monotonic() - began
        peaks = client.run(peak_mib)
    assert report.ok and report.recordings == count
    lengths = [round(report.frames / count)] * count
    what = {"root": str(tmp_path / "theirs"), "fps": 20, "names": None, "cameras": ["top"]}
    what |= {"dtype": "video", "codec": "h264", "colours": [[25] * 3, [225] * 3]}
    what |= {"episodes": [["follow the path"] * length for length in lengths]}
    (tmp_path / "drawn.json").write_text(json.dumps([what]))
    _, said = run(VERSION, "lerobot_writer.py", tmp_path / "drawn.json", home=tmp_path)
    found = f"{report.frames} frames, {ours_s:.0f} s through Dask, lerobot's writer"
    found += f" {said['seconds']:.0f} s; a worker at most {max(peaks.values()):.0f} MiB"
    note(f"short episodes exported, beside the writer of lerobot {VERSION}", count, found)
    assert max(peaks.values()) <= MOST_MIB
