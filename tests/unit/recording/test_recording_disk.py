"""F12, F14: disks that are full or slow. A small tmpfs stands in for the full one."""

from __future__ import annotations

import os
import random
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from helpers.recording import recording_synthetic as synthetic
from helpers.results.recording_results import note
from surg_recording.episode import episode_reader
from surg_recording.episode.csv_sink import CsvWriter
from surg_recording.episode.episode_recorder import Recording
from surg_recording.recording_errors import EpisodeError


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 6 MB."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=6m", "tmpfs", str(disk)]
    done = subprocess.run(mount, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        pytest.skip(f"no tmpfs can be mounted here: {done.stderr.strip()}")
    yield disk
    subprocess.run(["umount", "-l", str(disk)], check=True)


def test_f12_a_disk_that_fills_up_ends_the_recording_cleanly(small_disk: Path) -> None:
    recording = Recording(
        small_disk / "e",
        mode="freerun",
        arms=["PSM1"],
        cameras=["cam"],
        manifest={"run": {"operator": "A"}},
        min_free_bytes=2 << 20,
        stop_free_bytes=0,
    )
    (small_disk / "e.partial" / "others").write_bytes(bytes(3 << 20))
    rng = np.random.default_rng(1)
    what, longest, tick = synthetic.Synthetic(), 0.0, 0
    deadline = time.monotonic() + 120.0
    while not recording.failed and time.monotonic() < deadline:
        tick += 1
        begun = time.perf_counter()
        recording.cycle("PSM1", synthetic.cycle(what, tick, 1), tick)
        if tick % 25 == 0:
            image = synthetic.image(tick * synthetic.TICK_NS, 0, 320, 240)
            image.data = rng.integers(0, 255, 320 * 240 * 3, dtype=np.uint8).tobytes()
            recording.image("cam", image, tick)
        longest = max(longest, time.perf_counter() - begun)
        time.sleep(0.0005)
    assert recording.failed
    begun = time.monotonic()
    folder = recording.close({"stopped_ns": 1})
    took = time.monotonic() - begun
    result = f"longest call {longest * 1e3:.1f} ms; closed {took:.2f} s after the disk was full"
    note("disk of 6 MB", tick, result)
    assert sorted(path.name for path in small_disk.iterdir()) == ["e"], "no partial folder is left"
    recorded = episode_reader.read(folder)
    assert not recorded.complete
    assert "No space left" in recorded.manifest["reason"]
    assert recorded.manifest["run"] == {"operator": "A"}
    ticks = recorded.cycle("PSM1")["tick"]
    assert len(ticks) > 100 and np.array_equal(ticks, np.arange(1, len(ticks) + 1))
    assert recorded.manifest["tables"]["cycle_PSM1"]["dropped"] == tick - len(ticks)
    for video in recorded.parts("cam"):
        assert len(video.frames) > 0
    with pytest.raises(EpisodeError, match="MiB free, recording needs at least 2 MiB"):
        Recording(
            small_disk / "f", mode="freerun", arms=[], cameras=[], manifest={},
            min_free_bytes=2 << 20,
        )  # fmt: skip
    assert sorted(path.name for path in small_disk.iterdir()) == ["e"]


def test_f12_a_recording_ends_before_the_last_bytes_are_gone(small_disk: Path) -> None:
    recording = Recording(
        small_disk / "e",
        mode="freerun",
        arms=["PSM1"],
        cameras=[],
        manifest={},
        min_free_bytes=4 << 20,
        stop_free_bytes=2 << 20,
    )
    recording.cycle("PSM1", synthetic.cycle(synthetic.Synthetic(), 1, 1), 1)
    (small_disk / "others").write_bytes(bytes(3 << 20))
    begun = time.monotonic()
    while not recording.failed:
        assert time.monotonic() - begun < 1.0, "within a second"
        time.sleep(0.01)
    recorded = episode_reader.read(recording.close({}))
    assert "disk full" in recorded.manifest["reason"]
    assert len(recorded.cycle("PSM1")) == 1


def test_f14_a_slow_disk_drops_rows_counts_them_and_blocks_nobody(
    tmp_path: Path, rng: random.Random
) -> None:
    writer = CsvWriter()
    table = writer.table(tmp_path / "t.csv", ["stamp_ns", "x"], queue_limit=200)
    writer.flush(1.0)
    slow_end, end = os.pipe()
    os.dup2(end, table._fd)  # a disk that takes 40 kB/s
    os.close(end)
    taken = bytearray()

    def crawl() -> None:
        while part := os.read(slow_end, 400):
            taken.extend(part)
            time.sleep(0.01 if not writer._stop.is_set() else 0.0)

    reader = threading.Thread(target=crawl)
    reader.start()
    kept = []
    spent = time.thread_time()
    for k in range(20_000):
        if writer.put(table, (k, rng.random())):
            kept.append(k)
    spent = time.thread_time() - spent
    writer.close()  # it closed the write end
    reader.join(10.0)
    os.close(slow_end)
    rows = [int(line.split(b",")[0]) for line in bytes(taken).splitlines()]
    result = f"{len(rows)} rows written in order, {table.dropped} dropped and counted"
    note("disk of 40 kB/s", 20_000, result)
    assert rows == kept, "what was taken is written, in order"
    assert table.dropped == 20_000 - len(kept) > 0
    assert spent < 2.0
