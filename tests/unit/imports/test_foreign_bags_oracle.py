"""Bags as others write them, drawn: imported, exported, and read by the real lerobot.

Opt-in: `./surg test --tier oracle`; with `--full` twenty bags, written to docs/results/datasets.md.
"""

from __future__ import annotations

import random
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rosbag
from std_msgs.msg import Header

from helpers.foreign.foreign_pictures import BAYER, OTHERS, raw
from helpers.foreign.foreign_sources import (
    HZ,
    START_NS,
    BagMessage,
    samples,
    tip,
    twin,
    write_bag,
)
from helpers.recording import picture_identity
from helpers.recording.oracle_reading import run
from helpers.results.dataset_results import note
from surg_recording import datasets
from surg_recording.datasets import ExportOptions
from surg_recording.imports import bag_map
from surg_recording.imports.bag_import import import_bag
from surg_recording.imports.ledger import Ledger
from surg_recording.nodes.ros_messages_node import ros_time

pytestmark = pytest.mark.oracle

VERSION = "0.6.1"
LENGTH_S = 2.0
POSE = "/PSM1/measured_cp"
TASKS = ("pick the needle", "pass it; wait", "“Knoten” knüpfen")
COLOURS = (np.array([40, 60, 30], np.uint8), np.array([200, 170, 220], np.uint8))
"""Of dark and bright squares."""


@dataclass(frozen=True)
class Drawn:
    """One bag."""

    number: int
    fps: int
    encoding: str
    instruction: str
    storage: str
    """``rosbag``, or how ``rosbags-convert`` stores its twin."""
    compression: str
    latest_s: float
    """By which messages reach the bag after their stamps, at most [s]; TCP keeps their order."""
    set_back_s: float
    """By which the bag's clock is behind the stamps' [s]."""

    @property
    def count(self) -> int:
        """Of pictures."""
        return round(LENGTH_S * self.fps)


def draw(number: int) -> Drawn:
    rng = random.Random(number)
    return Drawn(
        number,
        rng.choice([10, 15, 20, 25, 30, 50]),
        rng.choice([*BAYER, *OTHERS, "rgb8; jpeg"]),
        rng.choice(TASKS),
        rng.choice(["rosbag", "rosbag", "mcap", "sqlite3"]),
        rng.choice(["none", "bz2", "lz4"]),
        rng.choice([0.0, 0.004, 0.06]),
        rng.choice([0.0, 0.0, 0.3]),
    )


def write(what: Drawn, folder: Path) -> Path:
    """Bag of an arm at ``HZ`` and a camera whose picture k says so; both begin together."""
    rng = random.Random(-1 - what.number)

    def heard(stamps_ns: list[int]) -> list[int]:
        late_s = [rng.uniform(0.0005, 0.001 + what.latest_s) for _ in stamps_ns]
        received = np.maximum.accumulate(np.array(stamps_ns) + 1e9 * np.array(late_s))
        return [round(each) for each in received - 1e9 * what.set_back_s]

    def pictures(bag: rosbag.Bag) -> None:
        stamps = [START_NS + round(k * 1e9 / what.fps) for k in range(what.count)]
        for k, (stamp_ns, received_ns) in enumerate(zip(stamps, heard(stamps), strict=True)):
            said = picture_identity.draw(picture_identity.Identity(what.number, 0, k))
            message: Any = raw(what.encoding, np.where(said > 128, COLOURS[1], COLOURS[0]))
            message.header = Header(stamp=ros_time(stamp_ns), frame_id="camera")
            bag.write("/cam/image", message, ros_time(received_ns))

    messages: list[BagMessage] = samples(round(LENGTH_S * HZ))
    received = heard([each.stamp_ns for each in messages])
    for each, received_ns in zip(messages, received, strict=True):
        each.received_ns = received_ns
    path = write_bag(
        folder / f"bag{what.number}.bag",
        messages,
        further=pictures,
        compression=what.compression,
    )
    return path if what.storage == "rosbag" else twin(path, folder / "ros2", what.storage)


def imported(what: Drawn, bag: Path, folder: Path) -> Path:
    """The bag's episode; nothing may be lost."""
    stated = {
        "arms": {"PSM1": {"measured_cp": POSE, "measured_js": "/PSM1/measured_js"}},
        "cameras": {"top": "/cam/image"},
        "instruction": what.instruction,
    }
    ledger = Ledger()
    import_bag(bag, folder, bag_map.of_yaml(stated), ledger)
    assert not ledger.dropped and ledger.kept["top"] == what.count
    return folder


def test_bags_come_back_as_they_were(tmp_path: Path, full: bool) -> None:
    (tmp_path / "ros2").mkdir()
    drawn = [draw(number) for number in range(20 if full else 3)]
    outs = []
    for what in drawn:
        folder = imported(what, write(what, tmp_path), tmp_path / f"episode{what.number}")
        outs.append(tmp_path / f"out{what.number}")
        options = ExportOptions(executor="serial", splits={"train": 1.0}, fps=what.fps)
        assert datasets.load("lerobot_v30").write([folder], outs[-1], options).ok
    words = (":".join(map(str, outs)), 10_000, 1)
    _, *lines = run(VERSION, "lerobot_reader.py", *words, home=tmp_path)
    begins = [place for place, line in enumerate(lines) if "episodes" in line]
    pictures, off = 0, []
    for what, begin, end in zip(drawn, begins, [*begins[1:], None], strict=True):
        facts, *frames = lines[begin:end]
        assert (facts["fps"], facts["episodes"]) == (what.fps, 1)
        assert len(frames) >= what.count - 2
        furthest = 0.0
        for frame in frames:
            seconds = (frame["grid_ns"] - START_NS) * 1e-9
            k = round(seconds * what.fps)
            assert list(frame["pictures"].values()) == [[what.number, 0, k]], what
            assert frame["task"] == what.instruction
            # On the chord between the two poses beside the frame: at most 1.7 um off the curve.
            np.testing.assert_allclose(frame["cartesian"][:3], tip(seconds), atol=2e-6)
            (shades,) = frame["shades"].values()
            furthest = max(furthest, float(np.abs(np.array(shades) - COLOURS).max()))
            pictures += 1
        off.append(furthest)
        print(f"{what}: {furthest:.1f} off")
    found = f"{pictures} pictures, 0 misplaced; rates, instructions, poses right; colours"
    note(
        f"bags of rosbag and rosbags: imported, exported, read by lerobot {VERSION}",
        len(drawn),
        f"{found} ≤ {max(off):.1f} of 255 off",
    )
    assert max(off) <= 3.0
