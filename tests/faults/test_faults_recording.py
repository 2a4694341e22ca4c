"""F09, F12 in running systems: a clock that is set and a disk that is full do not reach the arm."""

from __future__ import annotations

import dataclasses
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rospy
from std_msgs.msg import Bool

from faults.test_faults_ros import System
from helpers.graph.ros import RosGraph
from helpers.machines.set_clock import SetClock
from surg_cli.graph import episode_plans, system
from surg_cli.graph.episode_plans import Condition
from surg_cli.graph.processes import Child
from surg_cli.host import cells, paths
from surg_msgs.msg import Cycle, RecordStatus, SimStatus
from surg_recording.episode import episode_reader
from surg_sim.envs.cell_session import CellSession
from surg_sim.envs.episode_runner import run_episode

pytestmark = pytest.mark.ros

HOUR = 3600
SAID_S = 1.0
"""A step of the clock or a full disk is said within so much."""
SHORT = str(paths.ROOT / "tests" / "helpers" / "sim" / "short_bgr.py")
SEED = 10_001


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Callable[[int], Path]]:
    """Makes a file system of so many MB."""
    made: list[Path] = []

    def make(size: int) -> Path:
        disk = tmp_path / f"disk{len(made)}"
        disk.mkdir()
        mount = ["mount", "-t", "tmpfs", "-o", f"size={size}m", "tmpfs", str(disk)]
        done = subprocess.run(mount, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            pytest.skip(f"no tmpfs can be mounted here: {done.stderr.strip()}")
        made.append(disk)
        return disk

    yield make
    for disk in made:
        subprocess.run(["umount", "-l", str(disk)], check=True)


class Recorder:
    """A recorder of the arm in free-run, and what it says."""

    def __init__(self, graph: RosGraph, out: Path, env: dict[str, str] | None = None) -> None:
        self.graph = graph
        self.status = RecordStatus()
        self._switch = rospy.Publisher("/record/record", Bool, queue_size=1)
        self._ear = rospy.Subscriber("/record/status", RecordStatus, self._on_status)
        params = {"out": str(out), "mode": "freerun", "arms": ["PSM1"], "min_free_bytes": 0}
        self.node = graph.node("surg_recording", "recorder_node", "/recorder", params, env)
        self.wait(lambda: self.rows() > 200, "rows in the recording", 90.0)

    def _on_status(self, message: RecordStatus) -> None:
        self.status = message

    def rows(self) -> int:
        """Cycles written so far."""
        return sum(one.received for one in self.status.streams if one.name == "cycle_PSM1")

    def wait(self, condition: Callable[[], bool], what: str, limit: float = 10.0) -> float:
        """Wait; how long it took [s]."""
        begun = time.monotonic()
        self.graph.wait_for(condition, limit, what)
        return time.monotonic() - begun

    def stop(self) -> Path:
        """End the recording; its folder."""
        self._switch.publish(False)
        self.wait(lambda: bool(self.status.finished), "the finished episode", 30.0)
        return Path(self.status.finished)

    def close(self) -> None:
        """Leave the graph."""
        self._switch.unregister()
        self._ear.unregister()


TRIES = 3
STARVED = {"overrun", "link"}
"""A starved machine stops an arm (F27, F10), whatever else happens: then once more."""


def went_on(arm: System, first: int) -> bool:
    """Whether the arm has gone on as before since its cycle ``first``; False: the machine starved.

    Prints figures. Fails where anything else than a starved machine has stopped the arm.
    """
    cycles = arm.cycles[first:]
    ticks = [cycle.tick for cycle in cycles]
    assert ticks == list(range(ticks[0], ticks[0] + len(ticks))), "a cycle is missing"
    stopped = {cycle.reason for cycle in cycles if cycle.state != Cycle.ENABLED}
    periods = sorted(cycle.period_us * 1e-3 for cycle in cycles)
    p99 = periods[int(0.99 * len(periods))]
    print(f"{len(cycles)} cycles, period p99 {p99:.1f} ms, largest {periods[-1]:.1f} ms; {stopped}")
    assert stopped <= STARVED, arm.texts
    moving = min(float(np.linalg.norm(cycle.v_set)) for cycle in cycles[-50:])
    assert stopped or moving > 0.005, "it moves on"
    return not stopped


# --- F09 ------------------------------------------------------------------------------------------


@pytest.mark.full
def test_f09_a_clock_that_is_set_is_said_and_the_arm_goes_on(
    ros_graph: RosGraph, rospy_node: str, tmp_path: Path
) -> None:
    """The wall clock of every node jumps an hour ahead in motion, and back again."""
    clock = SetClock(tmp_path)
    ros_graph.supervisor.env.update(clock.env)
    arm = System(ros_graph)
    recorder = Recorder(ros_graph, tmp_path / "episode")
    set_at: list[int] = []
    try:
        clean = False
        while not clean and len(set_at) < 2 * TRIES:
            arm.in_motion()
            first = len(arm.cycles)
            for seconds in (HOUR, 0):
                set_at.append(time.time_ns() + seconds * 10**9)  # by the clock that is set
                clock.set(seconds * 10**9)
                count = len(set_at) + 1
                recorder.wait(lambda n=count: recorder.status.segments == n, "a step", 60)
                time.sleep(0.5)
            clean = went_on(arm, first)
        folder = recorder.stop()
    finally:
        arm.close()
        recorder.close()
    recorded = episode_reader.read(folder)
    assert recorded.complete, recorded.manifest["reason"]
    late = [s["begin_ns"] - at for s, at in zip(recorded.segments, set_at, strict=True)]
    print(f"{len(late)} steps, marked within {max(late) * 1e-6:.0f} ms")
    assert max(late) < SAID_S * 1e9
    steps = [segment["step_ns"] * 1e-9 for segment in recorded.segments]
    expected = [HOUR, -HOUR] * (len(set_at) // 2)
    assert steps == pytest.approx(expected, abs=0.05)
    assert list(recorded.table("events")["topic"]).count("clock_step") == len(set_at)
    cycle = recorded.cycle("PSM1")
    assert np.all(np.diff(cycle["tick"]) == 1), "no row is lost"
    # Half a step: a starved machine may let some seconds pass between two rows.
    jumps = np.flatnonzero(np.abs(np.diff(cycle["receive_ns"])) > HOUR * 10**9 / 2) + 1
    rows = np.array([segment["rows"]["cycle_PSM1"] for segment in recorded.segments])
    assert len(jumps) == len(rows)
    assert np.abs(jumps - rows).max() <= 1, (jumps, rows)


# --- F12 ------------------------------------------------------------------------------------------


def fill(disk: Path) -> None:
    """Use up what is left of a small file system."""
    with open(disk / "others", "wb", buffering=0) as file:
        size = 1 << 16
        while size:
            try:
                file.write(bytes(size))
            except OSError:
                size //= 16


@pytest.mark.full
def test_f12_a_disk_that_fills_up_does_not_reach_the_arm(
    ros_graph: RosGraph, rospy_node: str, small_disk: Callable[[int], Path]
) -> None:
    """In real time: the recording ends, the arm goes on in motion, cycle by cycle."""
    disk = small_disk(8)
    arm = System(ros_graph)
    recorder = Recorder(ros_graph, disk / "episode")
    try:
        arm.in_motion()
        time.sleep(0.5)
        first = len(arm.cycles)
        fill(disk)
        took = recorder.wait(lambda: bool(recorder.status.detail), "the full disk")
        recorder.wait(
            lambda: recorder.status.state == RecordStatus.STATE_IDLE, "the recording's end"
        )
        time.sleep(0.5)
        print(f"the full disk was said after {took:.2f} s")
        if not went_on(arm, first):
            pytest.skip("this machine is too busy to run an arm in real time at all")
        assert recorder.node.exit_code is None, "the recorder lives"
    finally:
        arm.close()
        recorder.close()
    assert took < SAID_S
    recorded = episode_reader.read(disk / "episode")
    assert not recorded.complete
    assert "No space left" in recorded.manifest["reason"]
    assert np.all(np.diff(recorded.cycle("PSM1")["tick"]) == 1)


class Listener:
    """Counts the cycles of arms and keeps what simulator and recorder say."""

    def __init__(self, arms: tuple[str, ...]) -> None:
        self.sim, self.record = SimStatus(), RecordStatus()
        self.ticks: dict[str, list[int]] = {arm: [] for arm in arms}
        self._lock = threading.Lock()
        keys = {"queue_size": None, "tcp_nodelay": True}
        self._ears = [
            rospy.Subscriber("/sim/status", SimStatus, self._on, "sim"),
            rospy.Subscriber("/record/status", RecordStatus, self._on, "record"),
        ]
        for arm in arms:
            ear = rospy.Subscriber(f"/{arm}/cycle", Cycle, self._on_cycle, arm, **keys)
            self._ears.append(ear)

    def _on(self, message: Any, name: str) -> None:
        setattr(self, name, message)

    def _on_cycle(self, message: Cycle, arm: str) -> None:
        with self._lock:
            self.ticks[arm].append(message.tick)

    def close(self) -> None:
        """Leave the graph."""
        for ear in self._ears:
            ear.unregister()


@pytest.mark.full
@pytest.mark.untimed
def test_f12_a_full_disk_changes_no_tick_of_a_run_in_lock_step(
    ros_graph: RosGraph, rospy_node: str, tmp_path: Path, small_disk: Callable[[int], Path]
) -> None:
    """The same run without a recorder, in one process: bit for bit the same states."""
    disk = small_disk(3)
    cell = cells.find("sim_two_arms")
    condition = Condition("phantom", "ours")
    plan = episode_plans.make_plan(SHORT, cell, cells.load(cell), [condition], SEED, (), tmp_path)
    plan = episode_plans.for_episode(plan, condition, SEED, tmp_path / "run")
    heard = Listener(plan.arms)
    recorder: Child | None = None
    try:
        for node in [*system.nodes(plan), *system.senders(plan)]:
            if node.name == "/recorder":
                small = {"out": str(disk / "episode"), "min_free_bytes": 0}
                recorder = system.start(
                    ros_graph.supervisor,
                    dataclasses.replace(node, params={**node.params, **small}),
                )
            else:
                system.start(ros_graph.supervisor, node)
        ros_graph.wait_for(
            lambda: heard.sim.state == SimStatus.STATE_DONE, 300.0, "the end of the run"
        )
        ros_graph.wait_for(
            lambda: heard.record.state == RecordStatus.STATE_IDLE, 60.0, "the recorder"
        )
        assert recorder is not None and recorder.exit_code is None, "the recorder lives"
    finally:
        heard.close()
    expected = run_episode(CellSession(cell, SHORT, "phantom", SEED), SEED)
    ticks = round(expected.duration / 0.002)
    assert heard.sim.state_hash == expected.hash
    assert (heard.sim.tick, heard.sim.deterministic) == (ticks, True)
    for arm, seen in heard.ticks.items():
        # The first ones may come before this listener is connected: nobody waits for it.
        assert seen == list(range(seen[0], ticks + 1)), arm
    recorded = episode_reader.read(disk / "episode")
    assert not recorded.complete
    assert "No space left" in recorded.manifest["reason"]
    kept = {name: len(recorded.cycle(name)) for name in plan.arms}
    assert all(100 < rows < ticks for rows in kept.values()), kept
    print(f"{ticks} ticks, {kept} rows until the disk was full; hash {expected.hash[:16]}")
