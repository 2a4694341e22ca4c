"""Sources that are damaged or made to harm: one sentence, exit 2, nothing else is touched."""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import rosbag
from std_msgs.msg import String

from helpers.foreign.foreign_sources import START_NS, Rows, samples, write_bag, write_set
from surg_cli.commands.episode import import_recordings
from surg_cli.host.terminal import CliError
from surg_recording import file_io
from surg_recording.imports import bag_file
from surg_recording.nodes.ros_messages_node import ros_time

INFO, EPISODES = "meta/info.json", "meta/episodes/chunk-000/file.parquet"
DATA, VIDEO = "data/chunk-000/file-000.parquet", "videos/observation.images.cam/file-000.mp4"
MIB = 1 << 20


def stating(**info: object) -> Callable[[Path], None]:
    def change(root: Path) -> None:
        stated = json.loads((root / INFO).read_text())
        (root / INFO).write_text(json.dumps({**stated, **info}))

    return change


def pipe(name: str) -> Callable[[Path], None]:
    def change(root: Path) -> None:
        (root / name).unlink()
        os.mkfifo(root / name)

    return change


def endless(root: Path) -> None:
    (root / DATA).unlink()
    (root / DATA).symlink_to("/dev/zero")


def no_text(root: Path) -> None:
    """A name in the footer is not UTF-8."""
    content = (root / EPISODES).read_bytes()
    (root / EPISODES).write_bytes(content.replace(b"data/chunk_index", b"data/\xff\xfeunk_index"))


def wide(root: Path) -> None:
    pq.write_table(pa.table({f"c{n}": [0.0] for n in range(10_001)}), root / DATA)


def bomb(root: Path) -> None:
    """Thirty million equal rows in some kilobytes."""
    names = ("episode_index", "frame_index", "timestamp", "observation.state", "action")
    table = pa.table({name: np.zeros(10_000_000, np.int64) for name in names})
    with pq.ParquetWriter(root / DATA, table.schema, compression="zstd") as writer:
        for _ in range(3):
            writer.write_table(table)


def no_episodes(root: Path) -> None:
    stating(total_episodes=0)(root)
    (root / EPISODES).unlink()


SETS: list[tuple[Callable[[Path], None], str]] = [
    (no_episodes, "holds no episode; looked for meta/episodes.jsonl"),
    (pipe(INFO), "is a named pipe"),
    (pipe(DATA), "is a named pipe"),
    (pipe(VIDEO), "is a named pipe"),
    (pipe(EPISODES), "is a named pipe"),
    (endless, "is a device"),
    (stating(total_episodes=10**12), "total_episodes is 1000000000000, meta/episodes lists 1"),
    (stating(total_episodes=-1), "total_episodes is -1"),
    (stating(data_path="data/{episode_index:0999999999d}"), "data_path is"),
    (stating(fps="1e999999999"), "no LeRobot data set"),
    (stating(fps=10**400), "no LeRobot data set"),
    (no_text, "bytes that are no text"),
    (wide, "columns; allowed: 10000"),
    (bomb, "more memory than one recording may take"),
]


def content(folder: Path) -> dict[str, bytes | int]:
    """Of every file: what it holds, or its kind."""
    return {
        str(each): each.read_bytes() if each.is_file() else each.lstat().st_mode
        for each in folder.rglob("*")
    }


def inflated(path: Path) -> Path:
    """A chunk of some kilobytes that unpacks to hundreds of MiB."""

    def zeros(bag: rosbag.Bag) -> None:
        for n in range(8):
            bag.write("/notes", String("0" * 50 * MIB), ros_time(START_NS + n))

    return write_bag(path, samples(20), further=zeros, compression="lz4", chunk_threshold=1 << 30)


def whole(path: Path) -> Path:
    """A folder of ROS 2 whose one file is compressed, and is no bag but zeros."""
    import zstandard

    zeros = zstandard.ZstdCompressor().compress(bytes(64 * MIB))
    path.mkdir()
    (path / "a.db3.zstd").write_bytes(zeros)
    about = {"version": 8, "storage_identifier": "sqlite3", "message_count": 0}
    about |= {"compression_format": "zstd", "compression_mode": "FILE"}
    about |= {"relative_file_paths": ["a.db3.zstd"], "topics_with_message_count": []}
    (path / "metadata.yaml").write_text(json.dumps({"rosbag2_bagfile_information": about}))
    return path


def waiting(path: Path) -> Path:
    os.mkfifo(path)
    return path


def never_ending(path: Path) -> Path:
    path.symlink_to("/dev/zero")
    return path


def garbled(path: Path) -> Path:
    """The definition of a type, which the library repeats, is not one."""
    write_bag(path, samples(20))
    data = path.read_bytes()
    path.write_bytes(data.replace(b"\nPose pose\n", b"\nPo\x1b[ pos\n"))
    return path


def empty(path: Path) -> Path:
    path.mkdir()
    return path


BAGS: list[tuple[Callable[[Path], Path], str]] = [
    (inflated, "copy or record it again (Failed to resize buffer)"),
    (whole, "File too large"),
    (waiting, "is a named pipe"),
    (never_ending, "is a device"),
    (garbled, "cut off or damaged: its index cannot be read"),
    (empty, "holds no bag; looked for metadata.yaml and *.mcap, *.db3 of ROS 2"),
]


def damaged(change: Callable[[Path], None]) -> Callable[[Path], Path]:
    """A data set that was whole before the change."""

    def make(path: Path) -> Path:
        change(write_set(path, [Rows(20, 10)], "v3.0"))
        return path

    return make


SOURCES = [("lerobot", 700, damaged(change), said) for change, said in SETS]
SOURCES += [("rosbag", 250, make, said) for make, said in BAGS]


@pytest.mark.parametrize(
    ("kind", "memory_mib", "make", "said"), SOURCES, ids=[f"{s[0]}: {s[3]}" for s in SOURCES]
)
def test_a_hostile_source_is_refused_and_left_alone(
    kind: str,
    memory_mib: int,
    make: Callable[[Path], Path],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(file_io, "MOST_MEMORY", memory_mib * MIB)
    monkeypatch.setattr(bag_file, "SPARE", MIB)
    (tmp_path / "in").mkdir()
    source, out, chart = make(tmp_path / "in/source"), tmp_path / "out", tmp_path / "map.yaml"
    parser = argparse.ArgumentParser()
    import_recordings.add_arguments(parser, "import")
    chart.write_text("arms: {PSM1: {measured: {x: 0, y: 1, z: 2}}}")
    words = [kind, str(source), "--out", str(out), *(["--map", str(chart)] * (kind == "lerobot"))]
    before, begun = content(source.parent), time.monotonic()
    try:
        assert import_recordings.main(parser.parse_args(words), "import") == 2
        (entry,) = json.loads((out / "import.json").read_text())["imports"]
        told = str(entry["refused"])
        assert {each.name for each in out.iterdir()} == {"import.json", "import.html"}
    except CliError as problem:
        assert problem.code == 2 and not out.exists()
        told = str(problem)
    assert time.monotonic() - begun < 60
    assert content(source.parent) == before
    assert said in told and "\n" not in told and len(told) < 600
    assert "Traceback" not in capfd.readouterr().err
