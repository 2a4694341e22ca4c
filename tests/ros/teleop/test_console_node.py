"""The console node between topics and pages: what a page does goes out, what is said comes in."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np
import pytest

import surg_core
from helpers.graph.ros import RosGraph
from helpers.graph.statuses import record_status, sim_status, teleop_status
from helpers.graph.surg import surg
from helpers.teleop.console_page import page, when
from surg_cli.graph import master
from surg_cli.host import paths

rospy = pytest.importorskip("rospy")
surg_msgs = pytest.importorskip("surg_msgs.msg")

from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped  # noqa: E402
from sensor_msgs.msg import Image, JointState, Joy  # noqa: E402
from std_msgs.msg import Bool, Float64, String  # noqa: E402

from crtk_msgs.msg import OperatingState, StringStamped  # noqa: E402
from surg_console.ros.console_node import Settings  # noqa: E402
from surg_console.web import picture_packet  # noqa: E402
from surg_console.web.access import AccessError  # noqa: E402
from surg_ros.params import ParamError  # noqa: E402

pytestmark = pytest.mark.ros

TURNED = [0.0, 0.0, float(np.sin(0.2)), float(np.cos(0.2))]
HEARD = {
    "/browser/measured_cp": PoseStamped,
    "/browser/measured_cv": TwistStamped,
    "/browser/gripper/measured_js": JointState,
    "/console/operator_present": Joy,
    "/console/clutch": Joy,
    "/console/camera": Joy,
    "/console/teleop/enable": Bool,
    "/console/teleop/set_rate_control": Bool,
    "/console/teleop/set_scale": Float64,
    "/record/record": Bool,
    "/PSM1/state_command": StringStamped,
}


class Bench:
    """An arm, a teleoperation and a camera on topics; keeps what the console says."""

    def __init__(self) -> None:
        def pub(topic: str, kind: type, latch: bool = False) -> Any:
            return rospy.Publisher(topic, kind, queue_size=10, tcp_nodelay=True, latch=latch)

        self.state = pub("/PSM1/operating_state", OperatingState, True)
        self.cycle = pub("/PSM1/cycle", surg_msgs.Cycle)
        self.warning = pub("/PSM1/warning", String)
        self.clearance = pub("/PSM1/clearance", surg_msgs.ScalarStamped)
        self.trocar = pub("/PSM1/trocar/measured_cf", WrenchStamped)
        self.tip = pub("/PSM1/tool/measured_cf", WrenchStamped)
        self.teleop = pub("/teleop/status", surg_msgs.TeleopStatus, True)
        self.record = pub("/record/status", surg_msgs.RecordStatus, True)
        self.sim = pub("/sim/status", surg_msgs.SimStatus, True)
        self.images = {eye: pub(f"/endoscope/{eye}/image_raw", Image) for eye in ("left", "right")}
        self.said: list[tuple[float, str, Any]] = []
        self.hand = {"state": "DISABLED", "mapping": "position"}
        self._ears = [
            rospy.Subscriber(topic, kind, self._hear, topic, tcp_nodelay=True)
            for topic, kind in HEARD.items()
        ]

    def _hear(self, message: Any, topic: str) -> None:
        self.said.append((time.monotonic(), topic, message))
        if topic == "/console/teleop/enable":
            self.hand["state"] = "FOLLOWING" if message.data else "DISABLED"
        elif topic == "/console/teleop/set_rate_control":
            self.hand["mapping"] = "rate" if message.data else "position"
        elif topic == "/console/clutch" and self.hand["state"] != "DISABLED":
            self.hand["state"] = "CLUTCHED" if message.buttons[0] else "FOLLOWING"
        self.teleop.publish(teleop_status(**self.hand))

    def of(self, topic: str) -> list[Any]:
        return [message for _, name, message in self.said if name == topic]

    async def live(self) -> None:
        """The arm's and the cameras' topics, until cancelled."""
        count = 0
        while True:
            count += 1
            stamp = rospy.Time(*divmod(time.time_ns(), 10**9))
            state = OperatingState(state="ENABLED", is_homed=True)
            state.header.stamp = stamp
            self.state.publish(state)
            deviation = 4e-4 if count % 10 == 0 else 1e-4
            self.cycle.publish(surg_msgs.Cycle(homed=True, depth=0.123, rcm_error=deviation))
            self.clearance.publish(surg_msgs.ScalarStamped(value=0.031))
            force = WrenchStamped()
            force.wrench.force.x, force.wrench.force.z = 3.0, 4.0
            self.trocar.publish(force)
            self.tip.publish(force)
            self.teleop.publish(teleop_status(**self.hand))
            for shade, publisher in zip((50, 200), self.images.values(), strict=True):
                image = Image(width=64, height=48, encoding="rgb8", step=192)
                image.header.stamp = stamp
                image.data = bytes([shade]) * (192 * 48)
                publisher.publish(image)
            await asyncio.sleep(0.05)


def start(ros_graph: RosGraph, **params: object) -> int:
    port = master.free_port()
    given = {"cell": paths.CELLS / "sim_ur5e", "port": port, "views": ["left", "right"], **params}
    ros_graph.node("surg_console", "console_node.py", "/console", given)
    ros_graph.wait_for(lambda: master.port_in_use(port), 40, "the console")
    return port


def run(bench: Bench, test: Callable[[], Coroutine[Any, Any, None]]) -> None:
    async def both() -> None:
        life, testing = asyncio.create_task(bench.live()), asyncio.create_task(test())
        done, _ = await asyncio.wait(
            {life, testing}, timeout=90.0, return_when=asyncio.FIRST_COMPLETED
        )
        assert done, "the test takes too long"
        life.cancel()
        for task in done:
            task.result()

    asyncio.run(both())


def test_a_page_is_a_leader_on_topics(ros_graph: RosGraph, rospy_node: str, tmp_path: Path) -> None:
    episode = tmp_path / "episodes" / "episode"
    episode.mkdir(parents=True)
    (episode / "manifest.json").write_text('{"outcome": "complete"}')
    port = start(ros_graph, episodes=episode)
    bench = Bench()

    async def test() -> None:
        async with page(port) as found:
            assert found.facts["arm"] == "PSM1" and found.facts["views"] == ["left", "right"]
            assert found.facts["limits"]["rcm_error_fault"] == pytest.approx(0.002)
            await when(lambda: found.status["gauges"]["trocar"] == 5.0, "the force")
            # Each topic has a connection of its own.
            await when(lambda: found.status["gauges"]["rcm_peak"] == 4e-4, "the peak")
            await when(lambda: found.status["gauges"]["rcm"] in (1e-4, 4e-4), "the deviation")
            await when(lambda: found.status["gauges"]["depth"] is not None, "the depth")
            await when(lambda: found.status["gauges"]["clearance"] is not None, "the clearance")
            assert found.status["gauges"]["depth"] == pytest.approx(0.123)
            assert found.status["gauges"]["clearance"] == pytest.approx(0.031)
            await when(lambda: [e["name"] for e in found.episodes] == ["episode"], "the list")

            await found.drive()
            assert bench.of("/console/operator_present")[-1].buttons[0] == 1
            found.hand = {"hand": "position", "p": [0.01, 0.02, 0.03], "q": TURNED, "grip": 0.7}
            await when(
                lambda: any(m.pose.position.z == 0.03 for m in bench.of("/browser/measured_cp")),
                "the pose",
            )
            pose = bench.of("/browser/measured_cp")[-1]
            q = pose.pose.orientation
            assert 2 * np.arctan2(q.z, q.w) == pytest.approx(0.4) and q.x == q.y == 0
            assert pose.header.stamp.to_sec() == pytest.approx(time.time(), abs=5.0)
            await when(
                lambda: any(m.position[0] == 0.7 for m in bench.of("/browser/gripper/measured_js")),
                "the grip",
            )

            found.hand = {
                "hand": "rate",
                "v": [0.01, 0, 0.02],
                "roll_rate": -0.5,
                "clutch": True,
                "tilt_x": 0.3,
            }
            await when(lambda: bench.hand["mapping"] == "rate", "the other mapping")
            await when(lambda: bench.of("/browser/measured_cv"), "the twist")
            twist = bench.of("/browser/measured_cv")[-1].twist
            assert (twist.linear.x, twist.linear.z, twist.angular.z) == (0.01, 0.02, -0.5)
            assert (twist.angular.x, twist.angular.y) == (0.3, 0.0)
            await when(lambda: any(m.buttons[0] for m in bench.of("/console/clutch")), "the clutch")

            await found.say("scale", value=0.4)
            await found.press("record")
            await when(lambda: bench.of("/record/record"), "the recording")
            assert bench.of("/record/record")[-1].data
            await when(lambda: bench.of("/console/teleop/set_scale"), "the scale")
            assert bench.of("/console/teleop/set_scale")[-1].data == 0.4
            bench.record.publish(record_status("RECORDING"))
            bench.sim.publish(sim_status(task="RUNNING", name="bgr", phase="point"))
            bench.warning.publish("PSM1: servo_cp refused: too far")
            await when(lambda: found.status["record"]["on"], "the recorder's answer")
            await when(lambda: (found.status["task"] or {}).get("now") == "point", "the task")

            await found.press("stop")
            await when(lambda: bench.of("/PSM1/state_command"), "the stop")
            assert bench.of("/PSM1/state_command")[-1].string == "pause"
            await when(lambda: not bench.of("/console/teleop/enable")[-1].data, "the hold")
            await when(lambda: "no message" in found.status["record"]["problem"], "the silence")
            assert found.status["record"]["on"], "a silent recorder may still be recording"
            present = "/console/operator_present"
        await when(lambda: bench.of(present)[-1].buttons[0] == 0, "the operator's absence")

    run(bench, test)


def test_a_page_feels_the_tip_while_it_follows(ros_graph: RosGraph, rospy_node: str) -> None:
    """At 20 Hz of the sensor, so that most forces are too old and some are told."""
    port = start(ros_graph)
    bench = Bench()

    async def test() -> None:
        origin = f"http://localhost:{port}"
        async with page(port) as found, aiohttp.ClientSession() as http:
            socket = await http.ws_connect(f"ws://localhost:{port}/feel", origin=origin)
            await socket.send_str('{"say": "hello", "token": ""}')

            async def words(count: int) -> list[Any]:
                heard = [await socket.receive_json(timeout=20.0) for _ in range(count)]
                assert all(w["tip"] is None or w["age"] <= 0.030 for w in heard)
                return [w["tip"] for w in heard]

            assert set(await words(20)) == {None}
            await found.drive()
            tips: set[Any] = set()
            while tips != {None, 5.0}:
                tips |= set(await words(1))
            found.hand = {"hand": "position", "clutch": True}
            await when(lambda: bench.hand["state"] == "CLUTCHED", "the clutch")
            await words(25)
            assert set(await words(20)) == {None}

    run(bench, test)


def test_both_eyes_come_encoded_and_a_killed_encoder_comes_back(
    ros_graph: RosGraph, rospy_node: str
) -> None:
    port = start(ros_graph)
    bench = Bench()

    async def test() -> None:
        import av

        async with aiohttp.ClientSession() as http:
            origin = f"http://localhost:{port}"
            socket = await http.ws_connect(f"ws://localhost:{port}/pictures", origin=origin)
            await socket.send_str('{"say": "hello", "token": ""}')
            await socket.send_str('{"say": "watch", "layout": "stereo", "codec": "h264"}')
            for life in range(2):
                packet = picture_packet.unpack((await socket.receive(30.0)).data)
                while life and not packet.key:
                    packet = picture_packet.unpack((await socket.receive(30.0)).data)
                assert packet.key and (packet.width, packet.height) == (128, 48)
                assert 0 <= packet.received_us - packet.exposed_us < 20_000_000
                decoder = av.CodecContext.create("h264", "r")
                frame = (decoder.decode(av.Packet(packet.data)) + decoder.decode(None))[0]
                pixels = frame.to_ndarray(format="rgb24")
                assert abs(pixels[:, :56].mean() - 50) < 6 and abs(pixels[:, 72:].mean() - 200) < 6
                if life == 0:
                    _kill_encoder(ros_graph)

    run(bench, test)


def _kill_encoder(ros_graph: RosGraph) -> None:
    import os
    import signal

    from surg_cli.graph.processes import session_members

    console = next(c for c in ros_graph.supervisor.children if c.name == "/console")
    (encoder,) = (
        pid
        for pid in session_members(console.process.pid)
        if b"video_node" in Path(f"/proc/{pid}/cmdline").read_bytes()
    )
    os.kill(encoder, signal.SIGKILL)


@pytest.mark.parametrize(
    ("params", "said"),
    [
        ({"cell": ""}, "~cell"),
        ({"cell": "/nowhere"}, "/nowhere"),
        ({"bind": "0.0.0.0"}, "TLS and a token"),
        ({"views": ["right"]}, "~views"),
        ({"views": 3}, "~views"),
        ({"arm": "ECM"}, "~arm is 'ECM'; allowed: PSM1"),
        ({"arms": ["PSM2"]}, "~arms"),
        ({"port": 0}, "1 to 65535"),
        ({"port": True}, "~port is True"),
        ({"volume": 11}, "~volume is unknown; allowed: ~cell"),
        ({"token_file": "/nowhere"}, "--token-file /nowhere"),
    ],
)
def test_parameters_that_must_not_be_used_are_named(params: dict[str, object], said: str) -> None:
    given = {"cell": str(paths.CELLS / "sim_ur5e"), "port": 8090, **params}
    with pytest.raises((ParamError, AccessError, surg_core.ConfigError)) as caught:
        Settings(given)
    assert said in str(caught.value)


def test_the_command_refuses_before_anything_starts() -> None:
    done = surg("teleop", "sim_ur5e", "--bind", "0.0.0.0")
    assert done.returncode == 2
    assert "anybody there could move the arm" in done.stderr
