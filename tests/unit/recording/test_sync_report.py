"""sync.json of made-up episodes in which clock, skew and lag are known."""

from __future__ import annotations

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from helpers.recording import camera_recording
from helpers.recording import recording_synthetic as synthetic
from helpers.recording.moving_pictures import Scene
from surg_recording.clock import clock_agreement, stream_skew, sync_page, sync_report
from surg_recording.episode import csv_sink, table_columns, table_rows
from surg_recording.episode import episode_reader as episodes

TICK_NS = synthetic.TICK_NS
START_NS = 1_700_000_000_000_000_000
SECOND = 1_000_000_000


def clock(ns: int, **what: Any) -> SimpleNamespace:
    """A message-like surg_msgs/ClockSync."""
    values = {"offset": 12e-6, "path_delay": 40e-6, "port_state": "SLAVE", "problem": "", **what}
    found = {"clock": "b.1", "grandmaster": "a.1", "in_step": not values["problem"], **values}
    return SimpleNamespace(header=synthetic.header(ns), **found)


def record(
    folder: Path,
    *,
    seconds: float = 4.0,
    clocks: list[SimpleNamespace] | None = None,
    machines: int = 2,
    mode: str = "freerun",
    late_ns: int = 300_000,
    truth_shift_ns: int = 0,
) -> Path:
    """An episode's files with the columns that count, written by hand."""
    folder.mkdir()
    stamps = [START_NS + k * TICK_NS for k in range(round(seconds / 0.002))]
    names: dict[str, list[str]] = {}

    def write(name: str, header: list[str], lines: list[tuple[Any, ...]]) -> None:
        text = "\n".join([",".join(header), *map(csv_sink.format_row, lines)]) + "\n"
        (folder / f"{name}.csv").write_text(text)
        names[name] = header

    first = ["stamp_ns", "receive_ns", "tick"]
    tip = ["p_tip_x", "p_tip_y", "p_tip_z"]
    cycles = [(t, t + late_ns, k, 0.1, 0.2, 0.3) for k, t in enumerate(stamps)]
    write("cycle_PSM1", [*first, *tip], cycles)
    truths = [(t + truth_shift_ns, t + late_ns, k) for k, t in enumerate(stamps)]
    write("ground_truth_PSM1", first, truths)
    if clocks:
        heard = [table_rows.clock_sync(m, table_rows.nanoseconds(m.header.stamp)) for m in clocks]
        write("clock_sync", table_columns.CLOCK_SYNC, heard)
    manifest = {
        "format": "surg_episode/1",
        "mode": mode,
        "outcome": "complete",
        "arms": ["PSM1"],
        "run": {"machines": machines},
        "started_ns": START_NS,
        "stopped_ns": START_NS + round(seconds * SECOND),
        "tables": {name: {"columns": header} for name, header in names.items()},
        "videos": {},
    }
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return folder


def every_second(seconds: float = 4.0, **what: Any) -> list[SimpleNamespace]:
    return [clock(START_NS + k * SECOND, **what) for k in range(int(seconds) + 1)]


def test_two_machines_in_step(tmp_path: Path) -> None:
    folder = record(tmp_path / "e", clocks=every_second())
    found = sync_report.write(folder)
    assert found["verdict"] == "pass"
    assert found["reasons"] == []
    assert found["offset_s"] == pytest.approx(12e-6)
    assert found["path_delay_s"] == pytest.approx(40e-6)
    assert found["grandmaster"] == "a.1"
    assert found["clock"]["samples"] == 5
    assert found["skew_s"] == {"p50": 0.0, "p95": 0.0, "max": 0.0}
    assert found["streams"]["cycle_PSM1"]["age_s"]["p50"] == pytest.approx(300e-6)
    assert json.loads((folder / "sync.json").read_text()) == found
    mark = episodes.read(folder).manifest["sync"]
    assert mark == {"verdict": "pass", "reasons": []}


def test_nothing_else_in_the_manifest_changes(tmp_path: Path) -> None:
    folder = record(tmp_path / "e", clocks=every_second())
    before = episodes.read(folder).manifest
    sync_report.write(folder)
    sync_report.write(folder)
    after = dict(episodes.read(folder).manifest)
    assert after.pop("sync")["verdict"] == "pass"
    assert after == before


@pytest.mark.parametrize(
    ("clocks", "machines", "words"),
    [
        ([], 2, "two machines, but no clock was monitored"),
        (every_second(offset=5e-3), 2, "the clock is +5.000 ms off its master"),
        (every_second(offset=-1.001e-3), 2, "the clock is -1.001 ms off its master"),
        (every_second(offset=5e-3), 1, "the clock is +5.000 ms off its master"),
        (every_second(port_state="LISTENING", offset=math.nan), 2, "no PTP master is heard"),
        (every_second(port_state="MASTER", offset=0.0), 2, "only the master's clock"),
        (
            [*every_second()[:1], clock(START_NS, port_state="", problem="no daemon")],
            2,
            "no daemon",
        ),
        ([*every_second()[:2], *every_second(grandmaster="c.1")[2:]], 2, "the grandmaster changed"),
    ],
)
def test_clocks_that_do_not_agree_mark_the_episode(
    tmp_path: Path, clocks: list[Any], machines: int, words: str
) -> None:
    folder = record(tmp_path / "e", clocks=clocks, machines=machines)
    found = sync_report.write(folder)
    assert found["verdict"] == "fail"
    assert any(words in reason for reason in found["reasons"]), found["reasons"]
    assert episodes.read(folder).manifest["sync"]["verdict"] == "fail"


def test_one_bad_look_among_good_ones_is_found_and_counted(tmp_path: Path) -> None:
    clocks = every_second()
    clocks[2] = clock(START_NS + 2 * SECOND, offset=-2e-3)
    found = sync_report.make(episodes.read(record(tmp_path / "e", clocks=clocks)))
    assert found["offset_s"] == pytest.approx(-2e-3)
    assert found["clock"]["offset_median_s"] == pytest.approx(12e-6)
    assert "(1 of 5 samples)" in found["reasons"][0]


def test_a_monitor_that_falls_silent_is_noticed(tmp_path: Path) -> None:
    folder = record(tmp_path / "e", seconds=7.0, clocks=every_second()[:2])
    found = sync_report.make(episodes.read(folder))
    assert found["verdict"] == "fail"
    assert "the clocks were not monitored for 6 s" in found["reasons"]


def test_one_machine_needs_no_clock(tmp_path: Path) -> None:
    found = sync_report.make(episodes.read(record(tmp_path / "e", machines=1)))
    assert (found["verdict"], found["clock"]["reasons"]) == ("pass", ["one machine, one clock"])


def test_lock_step_needs_no_clock(tmp_path: Path) -> None:
    found = sync_report.make(episodes.read(record(tmp_path / "e", mode="lockstep")))
    assert found["verdict"] == "pass"
    assert found["streams"]["cycle_PSM1"]["age_s"] is None  # stamps are no wall clock


@pytest.mark.parametrize(
    ("manifest", "machines"),
    [
        ({}, 1),
        ({"run": {"machines": 3}}, 3),
        ({"run": {"machines": ["robot", "operator"]}}, 2),
        ({"cell": {"network": "isolated"}}, 2),
        ({"cell": {"network": "loopback"}}, 1),
        ({"cell": None, "run": None}, 1),
    ],
)
def test_how_many_machines(manifest: dict[str, Any], machines: int) -> None:
    assert clock_agreement.machines(manifest) == machines


def test_a_step_of_the_clock_marks_the_episode(tmp_path: Path) -> None:
    """Stamps on either side cannot be compared, whatever the clocks say."""
    manifest = {"segments": [{"begin_ns": START_NS + SECOND, "step_ns": -3 * SECOND}]}
    folder = record(tmp_path / "e", machines=1)
    path = folder / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **manifest}))
    found = sync_report.make(episodes.read(folder))
    assert found["verdict"] == "fail"
    assert "the wall clock was set by -3.000 s" in found["reasons"][0]


def test_skew_of_a_stream_is_exact(tmp_path: Path) -> None:
    """Stamps 0.7 ms beside the grid of 2 ms, to the nanosecond; the ends count too."""
    folder = record(tmp_path / "e", truth_shift_ns=700_001)
    found = sync_report.make(episodes.read(folder))
    other = {*found["streams"]} - {found["reference"]}
    skew = found["streams"][other.pop()]["skew_s"]
    assert skew["p50"] == pytest.approx(700_001e-9, abs=1e-12)
    assert found["skew_s"] == skew


def test_a_stream_far_from_the_reference_fails(tmp_path: Path) -> None:
    folder = record(tmp_path / "e", truth_shift_ns=4 * SECOND)
    found = sync_report.make(episodes.read(folder))
    assert found["verdict"] == "fail"
    assert "or more from any of" in " ".join(found["reasons"])


def test_stamps_from_the_future_betray_a_clock_ahead(tmp_path: Path) -> None:
    folder = record(tmp_path / "e", machines=1, late_ns=-30_000_000)
    found = sync_report.make(episodes.read(folder))
    assert found["verdict"] == "fail"
    assert "is ahead of the recorder's" in found["reasons"][0]


def test_the_nearest_stamp_is_found_in_exact_integers() -> None:
    """Against the definition, with stamps that no float tells apart."""
    rng = np.random.default_rng(4)
    for _ in range(200):
        reference = START_NS + np.sort(rng.integers(0, 1000, rng.integers(1, 30)))
        stamps = START_NS + rng.integers(-50, 1050, 40)
        expected = [min(abs(int(s) - int(r)) for r in reference) for s in stamps]
        assert stream_skew.nearest_ns(stamps, rng.permutation(reference)).tolist() == expected


# --- with a real video --------------------------------------------------------------------------


def film(folder: Path, delay_s: float, still: bool = False, seconds: float = 14.0) -> Path:
    """An episode with an H.264 video whose frames bear stamps that are too late by ``delay_s``."""
    what = synthetic.Synthetic(seconds=seconds, constant=still, lag_s=0.0)
    recording = camera_recording.start(
        folder, "lockstep", arms=["PSM1"], cameras=["endoscope_left"]
    )
    ticks = round(seconds / 0.002)
    rng = np.random.default_rng(5)
    # A motion with features: the made-up path at a varying pace.
    pace = np.cumsum(0.002 * (1.0 + 1.5 * np.sin(np.cumsum(rng.normal(0, 0.05, ticks + 200)))))
    tip = np.array([what.executed(max(t, 0.0)) for t in pace])
    for tick in range(1, ticks + 1):
        message = synthetic.cycle(what, tick, 1)
        message.p_tip = list(synthetic.P_RCM + synthetic.R_BR @ tip[tick])
        recording.cycle("PSM1", message, tick)
    times = np.arange(0.0, seconds, 0.05)
    rows = np.clip(np.round((times - delay_s) / 0.002).astype(int), 0, ticks)
    seen = tip[rows] - [0.0, 0.0, 0.12]
    pictures = Scene(seed=3, noise=1.0).pictures(times, seen)
    for time, picture in zip(times, pictures, strict=True):
        data = np.repeat(np.kron(picture, np.ones((2, 2), np.uint8))[:, :, None], 3, axis=2)
        image = synthetic.image(TICK_NS + round(time * 1e9), 0, data.shape[1], data.shape[0])
        image.data = data.tobytes()
        recording.image("endoscope_left", image, 1)
    return recording.close({})


def test_an_injected_lag_of_200_ms_is_found_in_a_recorded_video(tmp_path: Path) -> None:
    found = sync_report.write(film(tmp_path / "e", 0.2))
    lag = found["video_lag"]["endoscope_left"]
    assert lag["verdict"] == found["verdict"] == "fail"
    assert lag["lag_s"] == pytest.approx(0.2, abs=0.05)
    assert "late against PSM1" in lag["reason"]


def test_an_episode_in_which_nothing_moves_cannot_tell(tmp_path: Path) -> None:
    found = sync_report.make(episodes.read(film(tmp_path / "e", 0.2, still=True, seconds=5.0)))
    lag = found["video_lag"]["endoscope_left"]
    assert (lag["verdict"], lag["lag_s"], found["verdict"]) == ("cannot_tell", None, "cannot_tell")
    assert "nothing moves" in lag["reason"]


def test_a_broken_video_is_named_and_the_rest_goes_on(tmp_path: Path) -> None:
    folder = record(tmp_path / "e", machines=1)
    (folder / "eye.mp4").write_bytes(b"no video")
    (folder / "eye.csv").write_text(
        f"frame,stamp_ns,receive_ns,pts,dropped\n0,{START_NS},{START_NS},0,0\n"
    )
    path = folder / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "videos": {"eye": {}}}))
    found = sync_report.make(episodes.read(folder))
    assert found["video_lag"]["eye"]["verdict"] == found["verdict"] == "cannot_tell"
    assert "no readable video" in found["video_lag"]["eye"]["reason"]
    assert found["skew_s"] is not None


def test_a_broken_table_is_named_and_the_rest_goes_on(tmp_path: Path) -> None:
    folder = record(tmp_path / "e", clocks=every_second())
    with open(folder / "ground_truth_PSM1.csv", "a") as file:
        file.write("1,2\n")
    found = sync_report.make(episodes.read(folder))
    assert found["verdict"] == "cannot_tell"
    assert "ground_truth_PSM1.csv, line 2002: 2 fields" in found["reasons"][0]
    assert found["offset_s"] == pytest.approx(12e-6)


def test_a_report_that_exists_is_not_made_again(tmp_path: Path) -> None:
    folder = record(tmp_path / "e", machines=1)
    first = sync_report.ensure(episodes.read(folder))
    (folder / "sync.json").write_text(json.dumps({**first, "verdict": "cannot_tell"}))
    assert sync_report.ensure(episodes.read(folder))["verdict"] == "cannot_tell"
    (folder / "sync.json").write_text("{")
    assert sync_report.ensure(episodes.read(folder))["verdict"] == "pass"


def test_the_section_of_the_report_says_it(tmp_path: Path) -> None:
    folder = record(tmp_path / "episode", clocks=every_second(offset=5e-3))
    page = sync_page.section(sync_report.make(episodes.read(folder)))
    assert "The streams are not synchronised" in page
    assert "+5.000 ms off its master" in page
    assert "at most 5000.0 µs off the master a.1, path delay 40.0 µs" in page


def test_the_recorder_writes_what_the_monitors_say(tmp_path: Path) -> None:
    recording = camera_recording.start(tmp_path / "e", arms=["PSM1"], cameras=())
    for message in every_second(3.0, port_state="LISTENING", offset=math.nan):
        recording.clock_sync(message, START_NS)
    table = episodes.read(recording.close({})).table("clock_sync")
    assert table.columns == table_columns.CLOCK_SYNC
    assert table["stamp_ns"].tolist() == [START_NS + k * SECOND for k in range(4)]
    assert np.isnan(table["offset_s"]).all()
    assert set(table["port_state"]) == {"LISTENING"}


def test_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good = record(tmp_path / "good", machines=1)
    bad = record(tmp_path / "bad")
    assert sync_report.main([str(good)]) == 0
    assert sync_report.main([str(good), str(bad)]) == 1
    assert sync_report.main([str(tmp_path / "none")]) == 2
    said = capsys.readouterr()
    assert "two machines, but no clock was monitored" in said.out
    assert "no such folder" in said.err
