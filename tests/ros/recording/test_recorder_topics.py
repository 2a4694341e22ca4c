"""The recorder node beyond an arm: any topic, tags, scripts, two connections, faults."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.graph.ros import RosGraph
from helpers.graph.statuses import complete
from helpers.graph.surg import surg
from helpers.graph.twin_publisher import TwinPublisher
from helpers.machines.set_clock import SetClock
from surg_cli.graph import master
from surg_cli.graph.processes import Supervisor

rospy = pytest.importorskip("rospy")
surg_msgs = pytest.importorskip("surg_msgs.msg")

from geometry_msgs.msg import PoseStamped  # noqa: E402
from sensor_msgs.msg import Image, JointState  # noqa: E402
from std_msgs.msg import Bool, Int64, String  # noqa: E402

from surg_recording.episode import episode_reader  # noqa: E402

pytestmark = pytest.mark.ros


class Bench:
    """Publishers of an arm and of some topics that no recorder knows."""

    def __init__(self, graph: RosGraph) -> None:
        def pub(topic: str, kind: type) -> Any:
            return rospy.Publisher(topic, kind, queue_size=0, tcp_nodelay=True)

        self.graph = graph
        self.cycle = pub("/PSM1/cycle", surg_msgs.Cycle)
        self.joints = pub("/PSM1/measured_js", JointState)
        self.number = pub("/counter", Int64)
        self.pose = pub("/tool/pose", PoseStamped)
        self.record = pub("/record/record", Bool)
        self.tag = pub("/record/tag", String)
        self.info = pub("/record/info", String)
        self.drift = pub("/endoscope/drift", surg_msgs.DriftStatus)
        self.publishers = [
            *(self.cycle, self.joints, self.number, self.pose),
            *(self.record, self.tag, self.info, self.drift),
        ]
        self.recording: bool | None = None
        self.status = surg_msgs.RecordStatus()
        self._subscribers = [
            rospy.Subscriber("/record/recording", Bool, self._on_recording),
            rospy.Subscriber("/record/status", surg_msgs.RecordStatus, self._on_status),
        ]

    def _on_recording(self, message: Any) -> None:
        self.recording = message.data

    def _on_status(self, message: Any) -> None:
        self.status = message

    def start(self, folder: Path, env: dict[str, str] | None = None, **params: Any) -> Any:
        child = self.graph.node(
            "surg_recording",
            "recorder_node",
            "/recorder",
            {
                "out": str(folder / "episode"),
                "mode": "freerun",
                "arms": ["PSM1"],
                "autostart": False,
                "min_free_bytes": 0,
                "topics": ["/PSM1/measured_*", "/counter", "/tool/pose", "/never", "/nobody/*"],
                **params,
            },
            env,
        )
        self.graph.wait_for(
            lambda: all(p.get_num_connections() > 0 for p in self.publishers), 60, "the recorder"
        )
        return child

    def begin(self) -> None:
        self.record.publish(True)
        self.graph.wait_for(lambda: self.recording is True, 20, "recording")

    def end(self) -> None:
        self.record.publish(False)
        self.graph.wait_for(lambda: self.recording is False, 20, "the stop")

    def rows(self, table: str) -> int:
        """Rows that the recorder says it has received."""
        return sum(stream.received for stream in self.status.streams if stream.name == table)

    def tick(self, k: int) -> tuple[Any, Any]:
        now = rospy.Time(*divmod(time.time_ns(), 10**9))
        cycle = surg_msgs.Cycle(tick=k, state=1)
        cycle.header.stamp = now
        cycle.q = cycle.qd = cycle.qd_command = [k / 3.0] * 6
        self.cycle.publish(cycle)
        joints = JointState(name=["a", "b"], position=[k / 7.0, -k / 11.0])
        joints.header.stamp = now
        self.joints.publish(joints)
        number = Int64(2**62 + k)
        self.number.publish(number)
        return cycle, number

    def close(self) -> None:
        for end in (*self.publishers, *self._subscribers):
            end.unregister()


@pytest.fixture
def bench(rospy_node: str, ros_graph: RosGraph) -> Iterator[Bench]:
    made = Bench(ros_graph)
    yield made
    made.close()


def _until(condition: Callable[[], bool], what: str, timeout: float = 30.0) -> None:
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, f"waited {timeout} s for {what}"
        time.sleep(0.01)


def test_any_topic_tags_and_facts_are_recorded(bench: Bench, tmp_path: Path) -> None:
    bench.start(tmp_path, run_info=json.dumps({"operator": "A", "task": "bgr"}))
    bench.info.publish(json.dumps({"operator": "B", "setting": "ex_vivo"}))
    bench.tag.publish("too early: nothing is recorded")
    time.sleep(0.2)
    bench.begin()
    for k in range(1, 101):
        bench.tick(k)
        if k == 30:
            bench.tag.publish('{"stage": "approach"}')
        time.sleep(0.001)
    told = complete("DriftStatus", {"state": 3, "refusal": "it moved", "detail": "moved: by 3 mm"})
    for _ in range(3):
        bench.drift.publish(told)
    bench.tag.publish("{broken")
    bench.tag.publish("slipped")
    bench.tag.publish('{"success": true}')
    _until(lambda: bench.status.stage == "approach", "the stage in the status")
    assert set(bench.status.waiting_for) == {"/tool/pose", "/never", "/nobody/*"}
    bench.end()
    recorded = episode_reader.read(tmp_path / "episode")
    assert recorded.complete, recorded.manifest["reason"]
    k = np.arange(1, 101)
    assert np.array_equal(recorded.cycle("PSM1")["tick"], k)
    (joints,) = recorded.topic("/PSM1/measured_js")
    assert np.array_equal(joints["position_0"], k / 7.0)
    assert np.array_equal(joints["stamp_ns"], recorded.cycle("PSM1")["stamp_ns"])
    (numbers,) = recorded.topic("/counter")
    assert numbers["data"].tolist() == [2**62 + int(i) for i in k]
    assert set(numbers["source"]) == {rospy.get_name()}
    manifest = recorded.manifest
    assert [s["name"] for s in recorded.stages] == ["approach"]
    assert recorded.stages[0]["end_ns"] > recorded.stages[0]["begin_ns"] > 10**18
    assert [t["text"] for t in recorded.tags] == ["slipped"]
    assert manifest["result"] == {"success": True, "reason": "", "by": rospy.get_name()}
    assert (manifest["operator"], manifest["setting"]) == ("B", "ex_vivo")
    assert manifest["task"] == "bgr"
    assert manifest["drift"] == {"since_ns": 7 * 10**9, "cause": "text", "text": "it moved"}
    events = recorded.table("events")
    said = zip(events["topic"], events["text"], strict=True)
    assert [text for topic, text in said if "drift" in topic] == ["moved: by 3 mm"], "once"
    assert manifest["parameters"]["recorder"]["mode"] == "freerun"
    silent = [text.partition(":")[0] for text in recorded.warnings]
    assert silent == ["/tool/pose", "/never", "/nobody/*"]
    assert manifest["topics"]["/never"]["messages"] == 0
    assert manifest["topics"]["/counter"]["type"] == "std_msgs/Int64"


def test_a_second_connection_doubles_no_row(bench: Bench, tmp_path: Path) -> None:
    bench.start(tmp_path)
    bench.begin()
    for k in range(1, 51):
        bench.tick(k)
    uri = _own_uri()
    node = master.call(bench.graph.uri, "lookupNode", "/recorder")
    twins = {
        "/PSM1/cycle": TwinPublisher(rospy.get_name(), "/PSM1/cycle", "surg_msgs/Cycle"),
        "/counter": TwinPublisher(rospy.get_name(), "/counter", "std_msgs/Int64"),
    }
    try:
        for topic, twin in twins.items():
            master.call(node, "publisherUpdate", topic, [uri, twin.uri])
            _until(lambda t=twin: t.listener is not None, f"a second connection of {topic}")
        for k in range(51, 151):
            cycle, number = bench.tick(k)
            twins["/PSM1/cycle"].send(cycle)
            twins["/counter"].send(number)
            time.sleep(0.001)
        time.sleep(0.2)
        bench.end()
    finally:
        for twin in twins.values():
            twin.close()
    recorded = episode_reader.read(tmp_path / "episode")
    assert recorded.complete, recorded.manifest["reason"]
    assert sorted(recorded.cycle("PSM1")["tick"]) == list(range(1, 151))
    (table,) = recorded.topic("/counter")
    assert sorted(table["data"]) == [2**62 + k for k in range(1, 151)]
    assert recorded.manifest["repeats"] == {"/PSM1/cycle": 100, "/counter": 100}
    assert recorded.manifest["topics"]["/counter"]["repeats"] == 100


def _own_uri() -> str:
    import rosgraph

    return str(rosgraph.Master("/test").lookupNode(rospy.get_name()))


def test_start_stop_and_tag_by_script(bench: Bench, tmp_path: Path) -> None:
    bench.start(tmp_path)
    port = bench.graph.uri.rpartition(":")[2].strip("/")
    done = surg("record", "start", "--port", port, "--info", "operator=C", "seed=7")
    assert done.returncode == 0, done.stderr
    assert "recording" in done.stdout and bench.recording is True
    for k in range(1, 21):
        bench.tick(k)
    assert surg("record", "start", "--port", port).returncode == 1
    assert surg("record", "stage", "cut", "--port", port).returncode == 0
    done = surg("record", "status", "--port", port)
    assert "cycle_PSM1: 20 rows" in done.stdout
    assert "nothing yet on /tool/pose" in done.stdout
    done = surg("record", "stop", "--outcome", "dropped it", "--port", port)
    assert done.returncode == 0, done.stderr
    assert "/never: nothing was received" in done.stderr
    recorded = episode_reader.read(done.stdout.strip().splitlines()[-1])
    assert (recorded.manifest["operator"], recorded.manifest["seed"]) == ("C", "7")
    assert recorded.manifest["result"]["reason"] == "dropped it"
    assert [s["name"] for s in recorded.stages] == ["cut"]
    done = surg("record", "tag", "late", "--port", port)
    assert done.returncode == 1 and "nothing is being recorded" in done.stderr


def test_f07_a_master_that_hangs_ends_no_recording(
    bench: Bench, tmp_path: Path, ros_session: Supervisor
) -> None:
    bench.start(tmp_path)
    (running,) = [c for c in ros_session.children if "master" in c.name]
    bench.begin()
    os.kill(running.process.pid, signal.SIGSTOP)
    try:
        for k in range(1, 1001):
            bench.tick(k)
            time.sleep(0.003)
        _until(lambda: bench.rows("cycle_PSM1") == 1000, "the last row")  # the stop may overtake it
        bench.end()
    finally:
        os.kill(running.process.pid, signal.SIGCONT)
    recorded = episode_reader.read(tmp_path / "episode")
    assert recorded.complete, recorded.manifest["reason"]
    assert recorded.cycle("PSM1")["tick"].tolist() == list(range(1, 1001))


def test_f09_a_step_of_the_clock_is_marked_at_once_and_at_its_row(
    bench: Bench, tmp_path: Path
) -> None:
    """The recorder's wall clock jumps an hour ahead and back, ten times in all."""
    clock = SetClock(tmp_path)
    bench.start(tmp_path, clock.env)
    bench.begin()
    k, set_at = 0, []

    def send() -> None:
        nonlocal k
        for _ in range(60):
            k += 1
            bench.tick(k)
            time.sleep(0.001)

    for step, hours in enumerate((1, 0) * 5):
        send()
        set_at.append(time.time_ns() + hours * 3600 * 10**9)
        clock.set(hours * 3600 * 10**9)
        # A starved recorder would see two steps between two of its rows.
        _until(lambda step=step: bench.status.segments == step + 2, f"step {step + 1}")
    send()
    bench.end()
    recorded = episode_reader.read(tmp_path / "episode")
    assert recorded.complete, recorded.manifest["reason"]
    late = [s["begin_ns"] - at for s, at in zip(recorded.segments, set_at, strict=True)]
    print(f"{len(late)} steps, marked within {max(late) * 1e-6:.1f} ms")
    assert min(late) >= 0
    cycle = recorded.cycle("PSM1")
    assert np.array_equal(cycle["tick"], np.arange(1, k + 1)), "no row is lost"
    jumps = np.flatnonzero(np.abs(np.diff(cycle["receive_ns"])) > 1800 * 10**9) + 1
    rows = np.array([segment["rows"]["cycle_PSM1"] for segment in recorded.segments])
    assert len(jumps) == len(rows)
    assert np.abs(jumps - rows).max() <= 1, (jumps, rows)


def test_f08_f09_a_stalled_camera_and_stamps_of_the_future_are_said(
    bench: Bench, tmp_path: Path
) -> None:
    camera = rospy.Publisher("/endoscope/left/image_raw", Image, queue_size=0)
    bench.publishers.append(camera)
    bench.start(tmp_path, cameras=["endoscope_left"])
    bench.begin()

    def send(ahead_ns: int = 0) -> None:
        picture = Image(width=64, height=48, step=192, encoding="rgb8", data=bytes(192 * 48))
        picture.header.stamp = rospy.Time(*divmod(time.time_ns() + ahead_ns, 10**9))
        camera.publish(picture)

    for k in range(1, 21):
        bench.tick(k)
        send()
        time.sleep(0.05)
    _until(lambda: bench.status.silent_cameras == ["endoscope_left"], "the stall")
    send(200_000_000)
    _until(lambda: bench.status.silent_cameras == [], "the camera's return")
    bench.end()
    recorded = episode_reader.read(tmp_path / "episode")
    events = list(recorded.table("events")["topic"])
    assert "camera_stall" in events and "camera_back" in events
    assert recorded.manifest["future_stamps"] == {"endoscope_left": 1}
    assert len(recorded.video("endoscope_left").frames) == 21
