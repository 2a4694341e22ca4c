"""Sets that the real lerobot wrote, drawn: imported, exported, and read by lerobot again.

Opt-in: `./surg test --tier oracle`; with `--full` forty sets.
"""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.recording.foreign_sources import MAP, NAMES
from helpers.recording.oracle_reading import run
from surg_recording import datasets, episode
from surg_recording.datasets import ExportOptions
from surg_recording.imports.ledger import Ledger
from surg_recording.imports.lerobot_reader import import_episode
from surg_recording.imports.lerobot_set import LeRobotData

pytestmark = pytest.mark.oracle

VERSION = "0.4.4"
TASKS = ("pick the needle", "pass it; wait", "“Knoten” knüpfen")
SECOND = 1_000_000_000


def draw(seed: int, root: Path) -> dict[str, Any]:
    """What to write."""
    rng = random.Random(seed)
    grouped = {"arm": NAMES[:3], "tool": NAMES[3:]}
    lengths = [rng.randrange(8, 30) for _ in range(rng.randrange(1, 4))]
    return {
        "root": str(root / f"set{seed}"),
        "fps": rng.choice([10, 12, 15, 20, 24, 25, 30, 50, 60]),
        "names": rng.choice([NAMES, {n: i for i, n in enumerate(NAMES)}, grouped, None]),
        "cameras": rng.choice([["top"], ["top", "wrist"]]),
        "dtype": rng.choice(["video", "video", "image"]),
        "codec": rng.choice(["h264", "hevc", "libsvtav1"]),
        "episodes": [
            sorted(rng.choice(TASKS[: rng.randrange(1, 4)]) for _ in range(count))
            for count in lengths
        ],
    }


def test_sets_of_lerobot_come_back_as_they_were(tmp_path: Path, full: bool) -> None:
    drawn = [draw(seed, tmp_path) for seed in range(40 if full else 3)]
    (tmp_path / "drawn.json").write_text(json.dumps(drawn))
    assert run(VERSION, "lerobot_writer.py", tmp_path / "drawn.json", home=tmp_path) == [
        {"lerobot": VERSION}
    ]
    for seed, what in enumerate(drawn):
        data, folders = LeRobotData(Path(what["root"])), []
        for number, texts in enumerate(what["episodes"]):
            folders.append(tmp_path / f"episode{seed}_{number}")
            ledger = Ledger()
            import_episode(data, number, folders[-1], MAP, ledger)
            assert not ledger.dropped
            said = episode.read(folders[-1]).manifest["run"]["instruction"]
            assert said == "; ".join(dict.fromkeys(texts))
        out = tmp_path / f"out{seed}"
        options = ExportOptions(executor="serial", splits={"train": 1.0}, fps=what["fps"])
        assert datasets.load("lerobot_v30").write(folders, out, options).ok
        _, facts, *frames = run(VERSION, "lerobot_reader.py", out, 10_000, 1, home=tmp_path)
        assert (facts["fps"], facts["episodes"]) == (what["fps"], len(folders))
        assert len(frames) >= sum(len(texts) - 2 for texts in what["episodes"])
        for frame in frames:
            k = round((frame["grid_ns"] - SECOND) * what["fps"] / SECOND)
            expected = [[frame["episode"], place, k] for place in range(len(what["cameras"]))]
            assert list(frame["pictures"].values()) == expected, what
            assert frame["stage"] == what["episodes"][frame["episode"]][k]
            np.testing.assert_allclose(frame["state"][1], 0.001 * k, atol=1e-6)
