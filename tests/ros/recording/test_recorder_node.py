"""The recorder node between fake publishers: what is sent is what the episode holds."""

from __future__ import annotations

import io
import json
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.graph.ros import RosGraph
from helpers.graph.statuses import sim_status
from surg_cli.host import paths

rospy = pytest.importorskip("rospy")
surg_msgs = pytest.importorskip("surg_msgs.msg")

from geometry_msgs.msg import PoseStamped  # noqa: E402
from sensor_msgs.msg import Image  # noqa: E402
from std_msgs.msg import Bool, Empty, String  # noqa: E402

from crtk_msgs.msg import OperatingState, StringStamped  # noqa: E402
from surg_recording.episode import episode_reader  # noqa: E402

pytestmark = pytest.mark.ros

TICK_NS = 2_000_000


def received(topic: str, command: Any, at_ns: int) -> Any:
    """What a controller says when /operator has sent it a command."""
    data = io.BytesIO()
    command.serialize(data)
    message = surg_msgs.ReceivedCommand(
        topic=topic, sender="/operator", type=command._type, data=data.getvalue()
    )
    message.header.stamp = rospy.Time(*divmod(at_ns, 10**9))
    return message


class Bench:
    """Publishers of everything a recorder listens to, and ears for what it says."""

    def __init__(self) -> None:
        def pub(topic: str, kind: type, latch: bool = False) -> Any:
            return rospy.Publisher(topic, kind, queue_size=0, tcp_nodelay=True, latch=latch)

        self.cycle = pub("/PSM1/cycle", surg_msgs.Cycle)
        self.truth = pub("/sim/ground_truth/state", surg_msgs.GroundTruth)
        self.received = pub("/PSM1/received", surg_msgs.ReceivedCommand)
        self.state = pub("/PSM1/operating_state", OperatingState, latch=True)
        self.warning = pub("/PSM1/warning", String)
        self.sim = pub("/sim/status", surg_msgs.SimStatus, latch=True)
        self.image = pub("/endoscope/left/image_raw", Image)
        self.record = pub("/record/record", Bool)
        self.ready: list[int] = []
        self.recording: bool | None = None
        self.status = surg_msgs.RecordStatus()
        self._subscribers = [
            rospy.Subscriber("/sim/ready", surg_msgs.Ready, lambda m: self.ready.append(m.tick)),
            rospy.Subscriber("/record/recording", Bool, self._on_recording),
            rospy.Subscriber("/record/status", surg_msgs.RecordStatus, self._on_status),
        ]

    def _on_recording(self, message: Any) -> None:
        self.recording = message.data

    def _on_status(self, message: Any) -> None:
        self.status = message

    @property
    def publishers(self) -> list[Any]:
        return [
            *(self.cycle, self.truth, self.received, self.state),
            *(self.warning, self.sim, self.image, self.record),
        ]

    def connected(self) -> bool:
        return all(p.get_num_connections() > 0 for p in self.publishers)

    def ready_link(self) -> bool:
        return self._subscribers[0].get_num_connections() > 0

    def close(self) -> None:
        for end in (*self.publishers, *self._subscribers):
            end.unregister()

    def tick(self, k: int, image: bool = True) -> None:
        stamp = rospy.Time(*divmod(k * TICK_NS, 10**9))
        command = PoseStamped()
        command.header.stamp = stamp
        command.pose.position.x = np.pi * k
        command.pose.orientation.w = 1.0
        self.received.publish(received("servo_cp", command, k * TICK_NS + 1))
        cycle = surg_msgs.Cycle(tick=k, state=1, homed=True, command=1, source="/operator")
        cycle.header.stamp = stamp
        cycle.q = cycle.qd = cycle.qd_command = [k / 3.0] * 6
        cycle.p_tip = [k / 7.0, -k / 11.0, 1e-17 * k]
        self.cycle.publish(cycle)
        truth = surg_msgs.GroundTruth(tick=k)
        truth.header.stamp = stamp
        arm = surg_msgs.ArmTruth(arm="PSM1", jaw=k / 13.0)
        truth.arms = [arm]
        self.truth.publish(truth)
        if k % 100 == 0:  # as the bridge does where somebody does not answer in time
            self.truth.publish(truth)
        if image and k % 25 == 0:
            self.send_image(k)

    def send_image(self, k: int) -> None:
        picture = np.full((48, 64, 3), (k // 25) * 5 % 256, np.uint8)
        message = Image(width=64, height=48, step=192, encoding="rgb8", data=picture.tobytes())
        message.header.stamp.secs, message.header.stamp.nsecs = divmod(k * TICK_NS, 10**9)
        self.image.publish(message)

    def run(self, first: int, last: int, window: int = 500) -> None:
        """Publish ticks with the simulator's flow control."""
        for k in range(first, last + 1):
            deadline = time.monotonic() + 10.0
            while k - (self.ready[-1] if self.ready else 0) > window:
                assert time.monotonic() < deadline, f"no Ready for tick {k}: {self.ready[-3:]}"
                time.sleep(0.002)
            self.tick(k)


@pytest.fixture
def bench(rospy_node: str, ros_graph: RosGraph) -> Any:
    made = Bench()
    yield made
    made.close()


def _start(graph: RosGraph, folder: Path, **params: Any) -> Any:
    return graph.node(
        "surg_recording",
        "recorder_node",
        "/recorder",
        {
            "out": str(folder / "episode"),
            "mode": "lockstep",
            "arms": ["PSM1"],
            "cameras": ["/endoscope/left/image_raw"],
            "run_info": json.dumps({"robot": "fake", "task": "test"}),
            "min_free_bytes": 0,
            **params,
        },
    )


def _until(condition: Callable[[], bool], what: str, timeout: float = 60.0) -> None:
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, f"waited {timeout} s for {what}"
        time.sleep(0.01)


@pytest.mark.untimed
def test_lockstep_episode_is_complete_to_the_tick(
    bench: Bench, ros_graph: RosGraph, tmp_path: Path
) -> None:
    _start(ros_graph, tmp_path)
    ros_graph.wait_for(bench.ready_link, 20, "the recorder on /sim/ready")
    # It says ready when its own side of each connection stands; the publisher counts a bit later.
    _until(bench.connected, "every connection of a recorder that said ready", 2.0)
    bench.state.publish(OperatingState(state="ENABLED", is_homed=True))
    bench.state.publish(OperatingState(state="ENABLED", is_homed=True))
    ticks = 1200
    begun = time.monotonic()
    bench.run(1, ticks)
    print(f"{ticks} ticks in {time.monotonic() - begun:.2f} s")
    bench.warning.publish('late, "quoted"\nand long')
    final = {"tick": ticks, "state_hash": "ff", "deterministic": True}
    bench.sim.publish(sim_status("DONE", **final))
    _until(lambda: bench.ready[-1] == ticks, "Ready for the last tick")
    assert bench.ready == sorted(set(bench.ready)), "Ready goes forward only"
    bench.record.publish(False)
    _until(lambda: bool(bench.status.finished), "the finished episode")
    _until(lambda: bench.recording is False, "the flag, which follows the status")
    assert bench.status.problem == surg_msgs.RecordStatus.PROBLEM_NONE
    assert not list(tmp_path.glob("*.partial"))

    recorded = episode_reader.read(bench.status.finished)
    assert recorded.complete, recorded.manifest["reason"]
    assert recorded.manifest["sim"]["state_hash"] == "ff"
    assert recorded.manifest["task"] == "test"
    assert recorded.manifest["versions"]["numpy"]
    k = np.arange(1, ticks + 1)
    for name in ("cycle_PSM1", "ground_truth_PSM1"):
        table = recorded.table(name)
        assert np.array_equal(table["tick"], k)
        assert np.array_equal(table["stamp_ns"], k * TICK_NS)
        assert recorded.manifest["tables"][name]["missing_ticks"] == 0
    cycle = recorded.cycle("PSM1")
    assert np.array_equal(cycle.vector("p_tip"), np.stack([k / 7.0, -k / 11.0, 1e-17 * k], 1))
    commands = recorded.table("command_PSM1")
    assert np.array_equal(commands["x"], np.pi * k)
    assert np.array_equal(commands["stamp_ns"], k * TICK_NS)
    assert np.array_equal(commands["receive_ns"], k * TICK_NS + 1)
    assert set(commands["source"]) == {"/operator"}
    video = recorded.video("endoscope_left")
    assert np.array_equal(video.frames["stamp_ns"], k[k % 25 == 0] * TICK_NS)
    events = recorded.table("events")
    texts = [t for n, t in zip(events["topic"], events["text"], strict=True) if "warning" in n]
    assert texts == ['late, "quoted" and long']
    states = [n for n in events["topic"] if n.endswith("operating_state")]
    assert len(states) == 1, "a state is an event when it changes"


def test_start_and_stop_by_topic_make_one_episode_each(
    bench: Bench, ros_graph: RosGraph, tmp_path: Path
) -> None:
    _start(ros_graph, tmp_path, mode="freerun", cameras=[], autostart=False)
    ros_graph.wait_for(
        lambda: bench.record.get_num_connections() > 0 and bench.cycle.get_num_connections() > 0,
        20,
        "the recorder",
    )
    for number, name in ((1, "episode"), (2, "episode_2")):
        bench.tick(1000 * number)  # before the start: not recorded
        time.sleep(0.2)
        bench.record.publish(True)
        _until(lambda: bench.recording is True, "recording")
        for k in range(1, 51):
            bench.tick(k, image=False)
        bench.record.publish(False)
        _until(lambda: bench.recording is False, "the stop")
        recorded = episode_reader.read(tmp_path / name)
        assert recorded.complete, recorded.manifest["reason"]
        assert list(recorded.cycle("PSM1")["tick"]) == list(range(1, 51))


def test_other_commands_are_recorded_as_their_controller_says_them(
    bench: Bench, ros_graph: RosGraph, tmp_path: Path
) -> None:
    """On request; the recorder itself subscribes to none of them."""
    own = rospy.Publisher("/PSM1/state_command", StringStamped, queue_size=1)
    _start(ros_graph, tmp_path, mode="freerun", cameras=[], topics=["/PSM1/*"])
    _until(lambda: bench.received.get_num_connections() > 0, "the recorder")
    _until(lambda: bench.recording is True, "recording")
    time.sleep(2.5)  # it has looked for topics
    assert own.get_num_connections() == 0
    bench.received.publish(received("state_command", StringStamped(string="enable"), 5))
    bench.received.publish(received("hold", Empty(), 6))
    bench.tick(1, image=False)
    time.sleep(0.2)
    bench.record.publish(False)
    _until(lambda: bench.recording is False, "the stop")
    own.unregister()
    recorded = episode_reader.read(tmp_path / "episode")
    (states,) = recorded.topic("/PSM1/state_command")
    assert (list(states["string"]), list(states["receive_ns"])) == (["enable"], [5])
    events = recorded.table("events")
    (row,) = np.flatnonzero(np.array(events["topic"]) == "/PSM1/hold")
    assert (events["receive_ns"][row], events["source"][row]) == (6, "/operator")


def test_a_tool_change_ends_the_recording(
    bench: Bench, ros_graph: RosGraph, tmp_path: Path
) -> None:
    cell = paths.ROOT / "cells" / "sim_ur5e"
    stated = "../../src/surg_description/instruments/grasper.yaml calibration/tool_PSM1.yaml"
    other = stated.replace("tool_PSM1", "trocar_PSM1")  # whatever it holds: the manifest has it
    tool = rospy.Publisher("/PSM1/tool/mounted", StringStamped, queue_size=1, latch=True)
    _start(ros_graph, tmp_path, mode="freerun", cameras=[], autostart=False, cell=str(cell))
    _until(lambda: bench.recording is False, "the recorder")
    _until(lambda: tool.get_num_connections() > 0, "the recorder at the tool")
    tool.publish(StringStamped(string=stated))
    time.sleep(0.3)
    found = []
    for mounted in (other, stated):
        bench.record.publish(True)
        _until(lambda: bench.recording is True, "the start")
        tool.publish(StringStamped(string=mounted))
        _until(lambda: bench.recording is False, "the end by the tool")
        _until(lambda: bench.status.finished not in {"", *found}, "the episode")
        found.append(bench.status.finished)
    first, second = (episode_reader.read(Path(folder)).manifest for folder in found)
    assert first["cell"]["arms"]["PSM1"]["mounted"] == stated
    assert second["cell"]["arms"]["PSM1"]["mounted"] == other
    assert second["cell"]["arms"]["PSM1"]["tool"]["format"] == "surg_trocar/1"
    assert any("tool was changed" in warning for warning in first["warnings"]), first["warnings"]
    tool.unregister()


def test_sigterm_finishes_and_kill_is_recovered(
    bench: Bench, ros_graph: RosGraph, tmp_path: Path
) -> None:
    child = _start(ros_graph, tmp_path)
    ros_graph.wait_for(bench.ready_link, 20, "the recorder on /sim/ready")
    bench.run(1, 600)
    _until(lambda: bench.ready[-1] == 600, "Ready")
    os.kill(child.process.pid, signal.SIGTERM)
    _until(lambda: (tmp_path / "episode" / "manifest.json").exists(), "the finished episode")
    assert episode_reader.read(tmp_path / "episode").complete
    _until(lambda: not bench.ready_link(), "the end of the recorder")

    bench.ready.clear()
    child = _start(ros_graph, tmp_path)
    _until(bench.ready_link, "the second recorder")
    bench.run(1, 600)
    _until(lambda: bench.ready[-1] == 600, "Ready")
    os.kill(child.process.pid, signal.SIGKILL)
    _until(lambda: not bench.ready_link(), "the killed recorder to go")
    assert (tmp_path / "episode_2.partial").is_dir()

    _start(ros_graph, tmp_path, autostart=False)
    _until(lambda: (tmp_path / "episode_2").is_dir(), "recovery")
    recovered = episode_reader.read(tmp_path / "episode_2")
    assert not recovered.complete
    assert "killed" in recovered.manifest["reason"]
    assert list(recovered.cycle("PSM1")["tick"]) == list(range(1, 601))  # Ready said: written
    assert len(recovered.video("endoscope_left").frames) >= 24 - 10


def test_a_disk_without_room_is_said_and_the_node_lives(
    bench: Bench, ros_graph: RosGraph, tmp_path: Path
) -> None:
    _start(ros_graph, tmp_path, min_free_bytes=1e18)
    ros_graph.wait_for(bench.ready_link, 20, "the recorder on /sim/ready")
    bench.run(1, 100)
    problem = surg_msgs.RecordStatus.PROBLEM_NOT_STARTED
    _until(lambda: bench.status.problem == problem, "the reason")
    assert "MiB free" in bench.status.detail
    _until(lambda: bench.ready[-1] == 100, "Ready: the simulation is not held up")
    assert bench.recording is False


def test_frames_that_are_still_under_way_are_waited_for(
    bench: Bench, ros_graph: RosGraph, tmp_path: Path
) -> None:
    _start(ros_graph, tmp_path)
    ros_graph.wait_for(bench.ready_link, 20, "the recorder on /sim/ready")
    late = []
    for k in range(1, 501):
        bench.tick(k, image=k <= 250)
        if k > 250 and k % 25 == 0:
            late.append(k)
    bench.record.publish(False)
    for k in late:  # the camera renders them only now
        time.sleep(0.3)
        bench.send_image(k)
    _until(lambda: bench.recording is False, "the stop")
    recorded = episode_reader.read(tmp_path / "episode")
    assert recorded.complete, recorded.manifest["reason"]
    stamps = recorded.video("endoscope_left").frames["stamp_ns"]
    assert stamps.tolist() == [k * TICK_NS for k in range(25, 501, 25)]


def test_frames_that_never_come_make_it_incomplete(
    bench: Bench, ros_graph: RosGraph, tmp_path: Path
) -> None:
    _start(ros_graph, tmp_path)
    ros_graph.wait_for(bench.ready_link, 20, "the recorder on /sim/ready")
    for k in range(1, 501):
        bench.tick(k, image=k <= 250)
    bench.record.publish(False)
    _until(lambda: bench.recording is False, "the stop")
    reason = episode_reader.read(tmp_path / "episode").manifest["reason"]
    assert reason == "endoscope_left: ends 0.50 s before the motion"
