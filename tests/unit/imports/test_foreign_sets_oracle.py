"""Sets that the real lerobot wrote, drawn: imported, exported, and read by lerobot again.

Opt-in: `./surg test --tier oracle`; with `--full` forty sets, written to docs/results/datasets.md.
"""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.foreign.foreign_sources import MAP, NAMES
from helpers.recording.oracle_reading import run
from helpers.results.dataset_results import note
from surg_recording import datasets, episode
from surg_recording.datasets import ExportOptions
from surg_recording.imports.ledger import Ledger
from surg_recording.imports.lerobot_reader import import_episode
from surg_recording.imports.lerobot_set import LeRobotData

pytestmark = pytest.mark.oracle

VERSIONS = {"0.4.4": 40, "0.6.1": 20}
"""Versions of lerobot, and how many sets are drawn of each with ``--full``."""
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
        "colours": [[rng.randrange(*span) for _ in "rgb"] for span in ((16, 90), (150, 240))],
        "episodes": [
            sorted(rng.choice(TASKS[: rng.randrange(1, 4)]) for _ in range(count))
            for count in lengths
        ],
    }


@pytest.mark.parametrize("version", VERSIONS)
def test_sets_of_lerobot_come_back_as_they_were(version: str, tmp_path: Path, full: bool) -> None:
    """Colours: as near to what lerobot reads from its own set as lerobot's own videos would be.

    FFmpeg turns 4:2:0 into r, g, b up to three levels off where lerobot reads it.
    """
    drawn = [draw(seed, tmp_path) for seed in range(VERSIONS[version] if full else 3)]
    (tmp_path / "drawn.json").write_text(json.dumps(drawn))
    versions, *own = run(version, "lerobot_writer.py", tmp_path / "drawn.json", home=tmp_path)
    assert versions == {"lerobot": version}
    outs = []
    for seed, what in enumerate(drawn):
        data, folders = LeRobotData(Path(what["root"])), []
        for number, texts in enumerate(what["episodes"]):
            folders.append(tmp_path / f"episode{seed}_{number}")
            ledger = Ledger()
            import_episode(data, number, folders[-1], MAP, ledger)
            assert not ledger.dropped
            said = episode.read(folders[-1]).manifest["run"]["instruction"]
            assert said == "; ".join(dict.fromkeys(texts))
        outs.append(tmp_path / f"out{seed}")
        options = ExportOptions(executor="serial", splits={"train": 1.0}, fps=what["fps"])
        assert datasets.load("lerobot_v30").write(folders, outs[-1], options).ok
    words = (":".join(map(str, outs)), 10_000, 1)
    _, *lines = run(version, "lerobot_reader.py", *words, home=tmp_path)
    begins = [place for place, line in enumerate(lines) if "episodes" in line]
    pictures = 0
    lost, off = np.array([each["lost"] for each in own]), np.zeros(len(drawn))
    for seed, (what, read) in enumerate(zip(drawn, own, strict=True)):
        facts, *frames = lines[begins[seed] : [*begins, None][seed + 1]]
        assert (facts["fps"], facts["episodes"]) == (what["fps"], len(what["episodes"]))
        assert len(frames) >= sum(len(texts) - 2 for texts in what["episodes"])
        for frame in frames:
            k = round((frame["grid_ns"] - SECOND) * what["fps"] / SECOND)
            expected = [[frame["episode"], place, k] for place in range(len(what["cameras"]))]
            assert list(frame["pictures"].values()) == expected, what
            assert frame["stage"] == what["episodes"][frame["episode"]][k]
            np.testing.assert_allclose(frame["state"][1], 0.001 * k, atol=1e-6)
            for place, shades in enumerate(frame["shades"].values()):
                theirs = np.array(read["shades"][f"{frame['episode']} {k} {place}"])
                off[seed] = max(off[seed], np.abs(theirs - shades).max())
                pictures += 1
        kind = f"{what['dtype']} {what['codec']}, {what['fps']} Hz"
        print(f"set {seed}: {kind}: {lost[seed]:.1f} theirs, {off[seed]:.1f} ours")
    found = f"{pictures} pictures, 0 misplaced; rates, instructions, states right; colours"
    found += f" ≤ {off.max():.1f} of 255 off, in lerobot's own videos {lost.max():.1f}"
    note(f"sets of lerobot {version}: imported, exported, read again", len(drawn), found)
    assert (off <= np.maximum(3, lost + 0.1)).all()
