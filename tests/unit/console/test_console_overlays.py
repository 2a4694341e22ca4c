"""What a page shows over and beside the picture: its sockets, the arms in the room, the marks."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import aiohttp
import numpy as np
import pytest

import surg_core
from helpers.async_tests import within
from helpers.endoscope_files import copied_cell
from helpers.teleop.console import console
from helpers.teleop.console_page import socket_of, when
from surg_cli.host import paths
from surg_console.ros.overlay_topics_node import marks_as_json
from surg_console.session.console_orders import Order
from surg_console.session.scene_view import SceneView

CELL = paths.CELLS / "sim_two_arms"


@pytest.mark.parametrize("what", ["marks", "plan", "scene", "feel"])
@within(30.0)
async def test_nothing_is_collected_until_a_page_asks_and_nothing_comes_in(what: str) -> None:
    async with console(pictures=False) as made, aiohttp.ClientSession() as http:
        assert made.system.watched == frozenset()
        made.system.shown[what] = '{"say": "first"}'
        sockets = [await socket_of(http, made.port, what) for _ in range(2)]
        for socket in sockets:
            assert (await socket.receive_json())["say"] == "first"
        assert made.system.watched == {what}
        made.system.shown[what] = '{"say": "second"}'
        assert (await sockets[0].receive_json())["say"] == "second"
        # A word on it, whatever it says, ends it; no order comes of it.
        await sockets[0].send_str('{"say": "press", "button": "enable", "at": 1}')
        assert (await sockets[0].receive()).type is aiohttp.WSMsgType.CLOSE
        assert made.system.watched == {what}, "the other page still watches"
        await sockets[1].close()
        await when(lambda: not made.system.watched, "the end", 5.0)
        assert [o for _, o in made.system.orders if isinstance(o, Order)] == []


def test_the_arms_stand_where_kinematics_puts_them() -> None:
    cell = surg_core.load_cell(CELL)
    joints = {name: np.array(arm.robot.home) for name, arm in cell.arms.items()}
    found = SceneView(cell).as_json(joints)
    json.dumps(found, allow_nan=False)
    assert [arm["name"] for arm in found["arms"]] == list(cell.arms) and found["silent"] == []
    for each in found["arms"]:
        arm = cell.arms[each["name"]]
        X_WF = arm.X_WB @ np.asarray(arm.chain.forward(joints[each["name"]]))
        tip = X_WF[:3, :3] @ arm.tool.p_FTip + X_WF[:3, 3]
        assert each["tip"] == pytest.approx(tip, abs=1e-4)
        ends = np.array(each["capsules"])[:, 3:6]
        assert np.linalg.norm(ends - tip, axis=1).min() < 2e-4, "the shaft ends at the tip"
        # At home the shaft goes through the trocar.
        a, b = (np.array(each["capsules"])[-1][s] for s in (slice(0, 3), slice(3, 6)))
        way = (b - a) / np.linalg.norm(b - a)
        off = np.array(each["trocar"]) - a
        assert np.linalg.norm(off - way * (off @ way)) < 0.002


def test_a_robot_without_capsules_is_drawn_from_joint_to_joint(tmp_path: Path) -> None:
    cell = surg_core.load_cell(copied_cell(tmp_path, "emulated_fr3"))
    (arm,) = cell.arms.values()
    assert not arm.robot.capsules
    q = np.array(arm.robot.home)
    (each,) = SceneView(cell).as_json({arm.name: q})["arms"]
    rows = np.array(each["capsules"])
    np.testing.assert_allclose(rows[1:, :3], rows[:-1, 3:6])  # one chain
    np.testing.assert_allclose(rows[0, :3], arm.X_WB[:3, 3], atol=1e-4)
    np.testing.assert_allclose(rows[-1, 3:6], each["tip"], atol=1e-4)


def test_an_arm_whose_joints_are_not_known_is_absent_and_named() -> None:
    cell = surg_core.load_cell(CELL)
    first, second = cell.arms
    home = np.array(cell.arms[first].robot.home)
    for wrong in (None, home[:3], np.full(len(home), np.nan)):
        joints = {first: home} if wrong is None else {first: home, second: wrong}
        found = SceneView(cell).as_json(joints)
        assert [arm["name"] for arm in found["arms"]] == [first] and found["silent"] == [second]


def test_marks_without_a_place_are_null() -> None:
    nan = float("nan")
    tip = SimpleNamespace(arm="A", name="tip", eye="left", x=[1.5], y=[2.5], ellipse=[4, 2, 0.1])
    line = SimpleNamespace(arm="A", name="shaft", eye="right", x=[nan, 3], y=[1, 4], ellipse=[])
    bad = replace_ellipse(tip, [nan, 1, 1])
    stamp = SimpleNamespace(to_nsec=lambda: 1_700_000_000_123_456_789)
    message = SimpleNamespace(
        header=SimpleNamespace(stamp=stamp), width=640, height=480, marks=[tip, line, bad]
    )
    found = marks_as_json(message)
    json.dumps(found, allow_nan=False)
    assert found["exposed_us"] == 1_700_000_000_123_456
    assert found["marks"][0]["points"] == [[1.5, 2.5]]
    assert found["marks"][0]["ellipse"] == [4, 2, 0.1]
    assert found["marks"][1]["points"] == [None, [3, 4]]
    assert found["marks"][1]["ellipse"] is None and found["marks"][2]["ellipse"] is None


def replace_ellipse(mark: SimpleNamespace, ellipse: list[float]) -> SimpleNamespace:
    return SimpleNamespace(**{**vars(mark), "ellipse": ellipse})
