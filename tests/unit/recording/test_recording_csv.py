"""CSV tables: exact round trips, bounded queues, broken disks, kills."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.recording import recording_synthetic as synthetic
from helpers.results.recording_results import note
from surg_recording.episode import (
    csv_sink,
    finishing,
    table_columns,
    table_file,
    table_rows,
)
from surg_recording.episode.csv_sink import CsvWriter
from surg_recording.episode.table import Table
from surg_recording.recording_errors import EpisodeError

NAMES = ["stamp_ns", "x", "text", "y"]


def write(path: Path, lines: list[tuple]) -> Table:
    writer = CsvWriter()
    table = writer.table(path, NAMES)
    for line in lines:
        assert writer.put(table, line)
    writer.close()
    assert table.rows == len(lines)
    return table_file.read_table(path)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.integers(-(2**63), 2**63 - 1),
            st.floats(),
            st.text(st.characters(blacklist_categories=("Cs",)), max_size=20),
            st.one_of(st.none(), st.floats(allow_nan=False)),
        ),
        max_size=20,
    )
)
def test_round_trip_is_exact(tmp_path_factory: pytest.TempPathFactory, lines: list[tuple]) -> None:
    table = write(tmp_path_factory.mktemp("csv") / "t.csv", lines)
    assert table["stamp_ns"].tolist() == [line[0] for line in lines]
    for column, place in (("x", 1), ("y", 3)):
        sent = [math.nan if line[place] is None else line[place] for line in lines]
        same = table[column].tobytes() == np.array(sent, dtype=float).tobytes()
        assert same or np.array_equal(table[column], sent, equal_nan=True)
    for got, line in zip(table["text"], lines, strict=True):
        assert got == line[2].replace("\r", " ").replace("\n", " ").replace("\0", " ")


def test_random_bit_patterns_survive(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    values = rng.integers(0, 2**64, 5000, dtype=np.uint64).view(float)
    values = values[np.isfinite(values)]
    table = write(tmp_path / "t.csv", [(i, float(v), "", v) for i, v in enumerate(values)])
    assert table["x"].tobytes() == values.tobytes() == table["y"].tobytes()
    print(f"{len(values)} floats")


def test_columns_fit_the_rows() -> None:
    what = synthetic.Synthetic(joints=7)
    row = table_rows.cycle(synthetic.cycle(what, 60, 1), 5)
    assert len(row) == len(table_columns.cycle(7))
    truth = synthetic.ground_truth(what, 60)
    row = table_rows.ground_truth(1, 60, truth.arms[0], 5)
    assert len(row) == len(table_columns.GROUND_TRUTH)
    for spherical, topic in ((False, "servo_cp"), (True, "servo_jp")):
        message = synthetic.pose(synthetic.Synthetic(spherical=spherical), 60)
        row = table_rows.command(topic, message, "/operator", 5)
        assert len(row) == len(table_columns.COMMAND)
        assert row[:4] == (120_000_000, 5, topic, "/operator")


def test_a_row_is_formatted_fast_enough() -> None:
    row = table_rows.cycle(synthetic.cycle(synthetic.Synthetic(), 60, 1), 5)
    best = math.inf
    for _ in range(20):
        begun = time.perf_counter()
        for _ in range(50):
            csv_sink.format_row(row)
        best = min(best, (time.perf_counter() - begun) / 50)
    print(f"{len(row)} columns in {best * 1e6:.0f} µs")
    assert best < 500e-6  # measured 25-35 µs; the bound only catches a blunder


def test_a_full_queue_drops_and_counts(tmp_path: Path) -> None:
    writer = CsvWriter(wake_s=0.5)
    table = writer.table(tmp_path / "t.csv", NAMES, queue_limit=10)
    kept = sum(writer.put(table, (i, 0.0, "", 0.0)) for i in range(25))
    assert kept == 10
    assert table.dropped == 15
    writer.close()
    assert table.rows == 10


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full")
def test_a_full_disk_is_an_error_and_no_exception(tmp_path: Path) -> None:
    writer = CsvWriter()
    good = writer.table(tmp_path / "good.csv", NAMES)
    bad = writer.table(tmp_path / "bad.csv", NAMES)
    full = os.open("/dev/full", os.O_WRONLY)
    os.dup2(full, bad._fd)
    os.close(full)
    writer.put(bad, (1, 0.0, "", 0.0))
    assert not writer.flush(2.0)
    assert "bad.csv: No space left" in str(writer.error)
    assert not writer.put(good, (1, 0.0, "", 0.0))
    writer.close()
    assert bad.dropped + good.dropped >= 2


def test_a_table_never_overwrites(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("precious\n")
    writer = CsvWriter()
    with pytest.raises(FileExistsError):
        writer.table(tmp_path / "t.csv", NAMES)
    writer.close()
    assert (tmp_path / "t.csv").read_text() == "precious\n"


_VICTIM = """
import sys, time
from pathlib import Path
from surg_recording.episode.csv_sink import CsvWriter
writer = CsvWriter()
table = writer.table(Path(sys.argv[1]), ["stamp_ns", "x", "text", "y"])
begun, k = time.monotonic(), 0
print("go", flush=True)
while True:
    k += 1
    while time.monotonic() < begun + k * 0.002:
        time.sleep(0.0005)
    writer.put(table, (time.monotonic_ns(), k / 7.0, "free, text", -k / 3.0))
"""


@pytest.mark.timed
def test_kill_9_loses_at_most_50_ms_of_rows(tmp_path: Path, full: bool) -> None:
    rng = np.random.default_rng(7)
    kills, worst = (20 if full else 3), 0.0
    for kill in range(kills):
        path = tmp_path / f"{kill}.csv"
        with subprocess.Popen(
            [sys.executable, "-c", _VICTIM, str(path)],
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        ) as victim:
            assert victim.stdout is not None
            victim.stdout.readline()
            time.sleep(rng.uniform(1.0, 2.0) if full else rng.uniform(1.0, 1.2))
            killed = time.monotonic_ns()
            os.kill(victim.pid, signal.SIGKILL)
        os.truncate(path, finishing.whole_lines(path))
        table = table_file.read_table(path)
        k = np.arange(1, len(table) + 1)
        assert np.array_equal(table["x"], k / 7.0)
        worst = max(worst, (killed - int(table["stamp_ns"][-1])) * 1e-6)
    note("kill -9 of the recorder: rows", kills, f"at most {worst:.1f} ms lost (≤ 50)")
    assert worst <= 50.0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "empty, not even a header"),
        ("stamp_ns,x\n1,2\n3\n", "line 3: 1 fields, the header has 2"),
        ("stamp_ns,x\n1,2\n1.5,2\n", "line 3, column stamp_ns: '1.5' is not a 64-bit integer"),
        ("stamp_ns,x\n99999999999999999999,2\n", "line 2, column stamp_ns"),
        ("stamp_ns,x\n1,ab\n", "line 2, column x: 'ab' is not a number"),
        ("x,x\n1,2\n", "line 1: a column name occurs twice"),
    ],
)
def test_a_broken_table_is_named_with_line_and_column(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "t.csv"
    path.write_text(text)
    with pytest.raises(EpisodeError, match=said) as caught:
        table_file.read_table(path)
    assert str(path) in str(caught.value)
