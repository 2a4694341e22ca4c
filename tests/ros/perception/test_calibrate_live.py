"""`./surg calibrate` from a running system: the whole chain, judged by what the simulator built.

The simulator, both controllers and the console run in lock-step graphs; base, camera and lens are
off by a setting that no node but the simulator's reads. The test is the person: it holds the board,
moves the endoscope by CRTK and brings the true tip to the board's corners.
"""

from __future__ import annotations

import asyncio
import json
import subprocess
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import aiohttp
import cv2
import numpy as np
import pytest

import surg_core
from helpers.endoscope_files import copied_cell
from helpers.graph import surg
from helpers.graph.ros import RosGraph
from helpers.perception.live_bench import ARMS, LiveBench
from helpers.results.perception_results import PAGE
from helpers.sim.board_bench import BenchView, Pattern, inner_corners, of_setting
from surg_cli.graph import master, system
from surg_cli.graph.system_plan import SystemPlan
from surg_core.camera_file import load_camera
from surg_perception.calibration.chain_steps import chain_error
from surg_perception.calibration.result_files import read_stereo
from surg_perception.calibration.small_motions import difference

pytestmark = [pytest.mark.ros, pytest.mark.full]

SETTING = "phantom+unregistered+lens"
COLUMNS, ROWS, SQUARE = 11, 8, 0.005
CORNERS = inner_corners(COLUMNS, ROWS, SQUARE)
ENDS = (0, COLUMNS - 2, len(CORNERS) - COLUMNS + 1, len(CORNERS) - 1)
TOUCHES = 32
OWN_TOPICS = {"/calibrate/status", "/rosout"}


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    """A cell of nobody's calibration, with the board it has printed."""
    folder = copied_cell(tmp_path)
    done = surg.surg("calibrate", folder, "board", "--to", tmp_path / "board.png")
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture
def live(cell: Path, ros_graph: RosGraph, rospy_node: str, tmp_path: Path) -> Iterator[LiveBench]:
    """The running system with the person beside it."""
    plan = SystemPlan(
        cell=cell,
        arms=ARMS,
        lockstep=True,
        cameras=(),
        out=ros_graph.folder,
        record=False,
        setting=SETTING,
        extra_participants=(rospy_node.lstrip("/"),),
    )
    for node in system.nodes(plan):
        params = dict(node.params)
        if node.name == "/sim":
            params["connect_timeout"] = 180.0
            params["abort_timeout"] = 300.0  # no time passes while the collector solves
        ros_graph.node(node.package, node.executable, node.name, params, arguments=node.arguments)
    picture = cv2.imread(str(tmp_path / "board.png"), cv2.IMREAD_GRAYSCALE)
    pattern = Pattern(np.asarray(picture, np.uint8), (COLUMNS * SQUARE, ROWS * SQUARE))
    made = LiveBench(of_setting(cell, pattern, SETTING, 0), rospy_node)
    try:
        ros_graph.wait_for(made.connected, 120.0, "simulator and controllers")
        made.sleep(0.1)
        yield made
    finally:
        made.close()


def collect(
    step: str, live: LiveBench, graph: RosGraph, cell: Path, show: Callable[[Any], None]
) -> str:
    """`./surg calibrate CELL STEP --live`, while ``show`` shows views; returns what it says."""
    log, port = graph.folder / f"{step}.log", graph.uri.rpartition(":")[2].rstrip("/")
    words = ("calibrate", cell, step, "--live", "--port", port, "--to", graph.folder / step)
    collector = surg.start(log, *words)
    try:
        graph.wait_for(lambda: live.seen() or collector.poll() is not None, 120.0, "the collector")
        assert collector.poll() is None, log.read_text()
        published = master.call(graph.uri, "getSystemState")[0]
        own = {topic for topic, nodes in published if "/calibrate" in nodes}
        assert own <= OWN_TOPICS, "it publishes nothing that an arm could obey"
        show(collector)
        assert collector.wait(300.0) == 0, log.read_text()
    finally:
        if collector.poll() is None:
            collector.kill()
            collector.wait()
    return log.read_text()


def views_on_page(port: int, least: int) -> dict[str, Any]:
    """The status that the page /calibrate shows, once it counts so many views."""

    async def look() -> dict[str, Any]:
        async with aiohttp.ClientSession() as http:
            url = f"ws://localhost:{port}/calibration"
            async with http.ws_connect(url, origin=f"http://localhost:{port}") as socket:
                await socket.send_str(json.dumps({"say": "hello", "token": ""}))
                async for message in socket:
                    said: dict[str, Any] = json.loads(message.data)
                    if said.get("running") and said["views"] >= least:
                        return said
        raise AssertionError("the console has closed the socket")

    return asyncio.run(asyncio.wait_for(look(), 60.0))


def postures(home: np.ndarray) -> Iterator[np.ndarray]:
    """Yaw, pitch, insertion, roll (4,) of the endoscope round the board, one after the other."""
    rng = np.random.default_rng(6)
    for number in range(40):
        angle = 2.4 * number  # round the circle in steps that never meet again
        tilt = rng.uniform(0.1, 0.3) * np.array([np.cos(angle), np.sin(angle)])
        step = np.append(tilt, [rng.uniform(-0.015, 0.015), rng.uniform(-0.5, 0.5)])
        yield home + step


def test_a_person_calibrates_a_running_cell(
    cell: Path, live: LiveBench, ros_graph: RosGraph, tmp_path: Path
) -> None:
    bench, page = live.bench, master.free_port()
    console = {"cell": cell, "port": page, "views": ["left", "right"]}
    ros_graph.node("surg_console", "console_node.py", "/console", console)
    ros_graph.wait_for(lambda: master.port_in_use(page), 60.0, "the console")
    live.sleep(0.1)
    before = {arm: live.joints[arm].copy() for arm in ARMS}

    def hold_board(collector: subprocess.Popen[bytes]) -> None:
        for number, view in enumerate(bench.held_board(150)):
            live.hold(view, collector)
            if number == 4:
                shown = views_on_page(page, 2)
                assert shown["step"] == "STEREO" and shown["views"] <= 5
            if collector.poll() is not None:
                return

    print(collect("stereo", live, ros_graph, cell, hold_board))
    for arm in ARMS:
        np.testing.assert_allclose(live.joints[arm], before[arm], atol=1e-5)

    live.enable()
    home = live.arms["ECM"].setpoint_jp()

    def move_scope(collector: subprocess.Popen[bytes]) -> None:
        for joints in postures(home):
            live.go("ECM", joints)
            X_VBoard = live.X_VBoard(bench.X_BBoard)
            if bench._sees(X_VBoard):
                live.hold(BenchView({}, X_VBoard), collector)
            if collector.poll() is not None:
                return

    print(collect("handeye", live, ros_graph, cell, move_scope))
    live.go("ECM", home)

    print(touch(cell, live, ros_graph))
    done = surg.surg("calibrate", cell, "check")
    assert done.returncode == 0, done.stderr
    print(done.stdout)
    judge(cell, live)


def touch(cell: Path, live: LiveBench, graph: RosGraph) -> str:
    """`./surg calibrate CELL bases --by touch --live`, Enter at each touch; what it says."""
    log, port = graph.folder / "bases.log", graph.uri.rpartition(":")[2].rstrip("/")
    words = ("calibrate", cell, "bases", "--by", "touch", "--live", "--port", port)
    terminal = surg.start(log, *words, "--to", graph.folder / "bases", typed=True)
    try:
        begun = partial(answered, log, 0)
        graph.wait_for(lambda: begun() or terminal.poll() is not None, 120.0, "the command")
        graph.wait_for(live.watched, 30.0, "its ears")
        for count, view in enumerate(live.bench.touches(CORNERS, [*ENDS] * (TOUCHES // 2))):
            assert f"  {count} of " in log.read_text(), log.read_text()
            assert terminal.poll() is None and terminal.stdin is not None, log.read_text()
            live.touch(place_of(live, view))
            terminal.stdin.write(b"\n")
            terminal.stdin.flush()
            live.show(view, partial(answered, log, count + 1))
            if count + 1 >= TOUCHES and "restart the system" in log.read_text():
                break
        assert terminal.wait(60.0) == 0, log.read_text()
    finally:
        if terminal.poll() is None:
            terminal.kill()
            terminal.wait()
    said = log.read_text()
    assert "not taken" not in said
    return said


def answered(log: Path, count: int) -> bool:
    """Whether the command has taken so many touches, or refused one, or has ended."""
    text = log.read_text()
    return any(word in text for word in (f"  {count} of ", "not taken", "restart the system"))


def place_of(live: LiveBench, view: BenchView) -> np.ndarray:
    """The corner (3,) in the base of PSM1, a hand's tremor beside it."""
    bench = live.bench
    X_WV = bench.X_WB["ECM"] @ bench.scope.arm.chain.forward(live.joints["ECM"]) @ bench.X_FV
    X_TV = surg_core.inverse_pose(bench.X_WB["PSM1"]) @ X_WV
    corner = (X_TV @ view.X_VBoard @ np.append(CORNERS[view.touch or 0], 1.0))[:3]
    return np.asarray(corner + bench.rng.normal(scale=bench.hand, size=3))


def judge(cell: Path, live: LiveBench) -> None:
    """The files against what the simulator built."""
    believed, bench = surg_core.load_cell(cell), live.bench
    eyes, _ = read_stereo(cell / "calibration")
    found = load_camera(cell / "calibration" / "camera_ECM.yaml").X_FV
    assert found is not None
    camera = difference(np.array(found), bench.X_FV)
    base = difference(np.array(believed.arms["ECM"].X_WB), bench.X_WB["ECM"])
    turn, shift = np.degrees(np.linalg.norm(camera[:3])), 1e3 * np.linalg.norm(camera[3:])
    base_turn = np.degrees(np.linalg.norm(base[:3]))
    off = 1e3 * (eyes.baseline - bench.X_LR[0, 3])
    apart = 1e3 * disagreement(believed, live)
    stated = 1e3 * chain_error(believed).two_sigma
    PAGE.note(
        "calibrated from a running system",
        1,
        f"baseline {off:+.4f} mm, hand-eye {shift:.3f} mm, {turn:.3f}° off, base {base_turn:.3f}° "
        f"off; true tip and its place by joints {apart:.2f} mm apart, stated {stated:.2f} mm",
    )
    assert abs(off) <= 0.01
    assert shift <= 0.3 and turn <= 0.1
    assert base_turn <= 0.2
    assert apart <= min(stated, 1.0)


def disagreement(believed: surg_core.Cell, live: LiveBench) -> float:
    """True place of the tip before the true eye, and where joints and files put it [m]."""
    bench, tool = live.bench, believed.arms["PSM1"]
    q_scope, q_tool = live.joints["ECM"], live.joints["PSM1"]
    scope = believed.arms["ECM"]
    X_FV = load_camera(believed.folder / "calibration" / "camera_ECM.yaml").X_FV
    X_WV = bench.X_WB["ECM"] @ scope.chain.forward(q_scope) @ bench.X_FV
    X_WV_believed = scope.X_WB @ scope.chain.forward(q_scope) @ np.array(X_FV)
    X_F = tool.chain.forward(q_tool)
    tip = X_F[:3, :3] @ tool.tool.p_FTip + X_F[:3, 3]
    true = surg_core.inverse_pose(X_WV) @ bench.X_WB["PSM1"] @ np.append(live.true_tip, 1.0)
    stated = surg_core.inverse_pose(X_WV_believed) @ tool.X_WB @ np.append(tip, 1.0)
    return float(np.linalg.norm((true - stated)[:3]))
