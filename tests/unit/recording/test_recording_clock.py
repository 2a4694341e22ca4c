"""F09: a clock that is set is noticed, by how much, and once; a clock that drifts is not."""

from __future__ import annotations

import random
import threading
import time
from collections import deque
from pathlib import Path
from typing import Any

import pytest

from helpers.recording import camera_recording
from helpers.recording import recording_synthetic as synthetic
from surg_recording.clock.clock_steps import STEP_NS, SteppedClock
from surg_recording.episode import episode_reader

HOUR = 3_600_000_000_000


class Clocks:
    """A wall clock and a steady one under the test's hand."""

    def __init__(self) -> None:
        self.steady_ns, self.offset_ns = 5_000_000_000, 1_732_000_000_000_000_000
        self.preempted: list[int] = []

    def steady(self) -> int:
        self.steady_ns += 100
        return self.steady_ns

    def wall(self) -> int:
        found = self.steady() + self.offset_ns
        if self.preempted:
            self.steady_ns += self.preempted.pop()
        return found


@pytest.fixture
def clocks() -> Clocks:
    return Clocks()


def stepped(clocks: Clocks) -> tuple[SteppedClock, list[tuple[int, int]]]:
    steps: list[tuple[int, int]] = []
    clock = SteppedClock(lambda by, at: steps.append((by, at)), clocks.wall, clocks.steady)
    return clock, steps


@pytest.mark.parametrize("step", [HOUR, -HOUR, 20_000_000, -20_000_000, 10_100_000])
def test_f09_a_step_is_noticed_at_the_next_reading_and_once(clocks: Clocks, step: int) -> None:
    clock, steps = stepped(clocks)
    for _ in range(1000):
        clocks.steady_ns += 2_000_000
        clock.now_ns()
    clocks.offset_ns += step
    now = clock.now_ns()
    assert [by for by, _ in steps] == [pytest.approx(step, abs=1000)]
    assert now == steps[0][1]
    for _ in range(1000):
        clocks.steady_ns += 2_000_000
        assert clock.now_ns() >= now
    assert len(steps) == 1


def test_f09_a_clock_that_is_slewed_for_an_hour_does_not_step(clocks: Clocks) -> None:
    clock, steps = stepped(clocks)
    for _ in range(360_000):  # 500 ppm, as much as NTP and PTP ever slew, read at 100 Hz
        clocks.steady_ns += 10_000_000
        clocks.offset_ns += 5_000
        clock.now_ns()
    assert steps == []


def test_f09_nobody_gets_a_time_behind_a_step_before_it_is_told(clocks: Clocks) -> None:
    """Else rows behind the step would be counted as before it."""
    told = threading.Event()
    early: list[bool] = []

    def reader() -> None:
        clock.now_ns()
        early.append(not told.is_set())

    def on_step(step: int, wall: int) -> None:
        thread.start()
        time.sleep(0.1)
        told.set()

    clock = SteppedClock(on_step, clocks.wall, clocks.steady)
    thread = threading.Thread(target=reader)
    clocks.offset_ns += HOUR
    clock.now_ns()
    thread.join()
    assert early == [False]


def test_f09_being_preempted_between_the_readings_is_no_step(
    clocks: Clocks, rng: random.Random
) -> None:
    clock, steps = stepped(clocks)
    for _ in range(5000):
        clocks.steady_ns += 2_000_000
        if rng.random() < 0.1:
            clocks.preempted = [rng.randrange(1, 50 * STEP_NS)]
        clock.now_ns()
    assert steps == []


def test_f09_a_step_begins_a_segment_and_future_stamps_are_counted(tmp_path: Path) -> None:
    recording = camera_recording.start(tmp_path / "e", arms=["PSM1"], cameras=())
    what, start = synthetic.Synthetic(), 1_732_000_000_000_000_000
    for tick in range(1, 101):
        message = synthetic.cycle(what, tick, 0)
        message.header = synthetic.header(start + tick * 2_000_000)
        recording.cycle("PSM1", message, start + tick * 2_000_000)
    recording.clock_stepped(-HOUR, start - HOUR)
    for tick in range(101, 111):  # the sender's clock has not been set
        message = synthetic.cycle(what, tick, 0)
        message.header = synthetic.header(start + tick * 2_000_000)
        recording.cycle("PSM1", message, start - HOUR + tick * 2_000_000)
    assert recording.status()["segments"] == 2
    assert recording.status()["future_stamps"] == {"cycle_PSM1": 10}
    recorded = episode_reader.read(recording.close({}))
    assert recorded.complete, "nothing was lost"
    (segment,) = recorded.segments
    assert (segment["step_ns"], segment["begin_ns"]) == (-HOUR, start - HOUR)
    assert segment["rows"]["cycle_PSM1"] == 100
    assert recorded.manifest["future_stamps"] == {"cycle_PSM1": 10}
    events = recorded.table("events")
    assert list(events["topic"]) == ["clock_step"]
    assert any("-3600.000 s" in text for text in recorded.warnings)
    assert any("10 stamps" in text for text in recorded.warnings)


def test_f09_rows_before_a_step_are_counted_while_others_are_written(tmp_path: Path) -> None:
    """The step is noticed in the middle of the writer's work: a row is in its queue and counted."""
    recording = camera_recording.start(tmp_path / "e", arms=["PSM1"], cameras=())
    steps: list[int] = []

    class Watched(deque[Any]):
        def popleft(self) -> Any:
            steps.append(len(steps))
            recording.clock_stepped(HOUR, 1)
            return super().popleft()

    what = synthetic.Synthetic()
    recording.cycle("PSM1", synthetic.cycle(what, 1, 0), 1)
    table = recording.tables.all()["cycle_PSM1"]
    while table.backlog:
        time.sleep(0.001)
    table._queue = Watched()
    for tick in range(2, 9):
        recording.cycle("PSM1", synthetic.cycle(what, tick, 0), tick)
    recorded = episode_reader.read(recording.close({}))
    assert len(steps) == 7
    assert recorded.segments[-1]["rows"]["cycle_PSM1"] == 8
    assert {s["rows"]["cycle_PSM1"] for s in recorded.segments} <= set(range(2, 9))


def test_f09_stamps_of_the_simulator_are_of_no_future(tmp_path: Path) -> None:
    recording = camera_recording.start(tmp_path / "e", "lockstep", arms=["PSM1"], cameras=())
    recording.cycle("PSM1", synthetic.cycle(synthetic.Synthetic(), 90_000, 0), 7)
    assert episode_reader.read(recording.close({})).manifest["future_stamps"] == {}
