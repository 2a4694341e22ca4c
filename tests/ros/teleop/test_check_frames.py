"""`./surg check-frames` on the running graph: the right cell passes, wrong wiring does not."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import surg_core
from helpers.graph.ros import RosGraph
from helpers.graph.surg import surg
from helpers.teleop.drawn_endoscope import DrawnEndoscope
from surg_cli.graph import processes, system
from surg_cli.graph.system_plan import SystemPlan
from surg_cli.host import paths

pytestmark = pytest.mark.ros

FULL = os.environ.get("SURG_TEST_FULL", "") not in ("", "0")
CELL = paths.CELLS / "sim_two_arms"
Picture = NDArray[np.uint8]


def test_what_cannot_be_checked_is_refused_before_anything_starts(tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = surg("check-frames", "sim_ur5e", "--out", out)
    assert done.returncode == 2
    assert "no arm holds an endoscope" in done.stderr
    assert "sim_two_arms" in done.stderr
    done = surg("check-frames", "sim_two_arms", "--arm", "ECM", "--out", out)
    assert done.returncode == 2
    assert "PSM1" in done.stderr
    assert not out.exists()


@pytest.mark.skipif(not FULL, reason="half a minute: SURG_TEST_FULL=1 runs it")
def test_the_bundled_cell_passes_and_leaves_a_picture(tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = surg("check-frames", "--out", out)
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads((out / "check_frames.json").read_text("utf-8"))
    print(done.stdout)
    assert (found["outcome"], found["cause"]) == ("pass", "none")
    assert [seen["told"] for seen in found["seen"]] == ["right", "down", "away"]
    assert found["seen"][0]["pixels"][0] > 20
    assert found["seen"][2]["disparity"] < -0.5
    assert (out / "check_frames.png").stat().st_size > 10_000


def start(
    graph: RosGraph, out: Path, enable: bool, lockstep: bool = True
) -> dict[str, processes.Child]:
    """The graph and the check in it, by node."""
    plan = SystemPlan(
        cell=CELL,
        arms=("PSM1", "ECM"),
        lockstep=lockstep,
        cameras=(),
        out=graph.folder,
        record=False,
        extra_participants=("check_frames",),
    )
    children = {}
    for node in system.nodes(plan):
        params = dict(node.params)
        if node.name == "/sim":
            params["connect_timeout"] = 180.0
        children[node.name] = graph.node(
            node.package, node.executable, node.name, params, arguments=node.arguments
        )
    params = {"cell": str(CELL), "lockstep": lockstep, "enable": enable, "out": str(out)}
    name = "/check_frames"
    children[name] = graph.node("surg_teleop", "check_frames_node.py", name, params)
    return children


WIRINGS: dict[str, Callable[[Picture, Picture], tuple[Picture, Picture]]] = {
    "none": lambda a, b: (a, b),
    "eyes_swapped": lambda a, b: (b, a),
    "mirrored": lambda a, b: (a[:, ::-1], b[:, ::-1]),
    "upside_down": lambda a, b: (a[::-1, ::-1], b[::-1, ::-1]),
}


@dataclass
class Bench:
    """The graph before a drawn endoscope: an arm, two controllers, real topics."""

    graph: RosGraph
    out: Path
    made: list[DrawnEndoscope] = field(default_factory=list)

    def start(self, cause: str = "none", **how: bool) -> dict[str, processes.Child]:
        self.made.append(DrawnEndoscope(surg_core.load_cell(CELL), WIRINGS[cause]))
        return start(self.graph, self.out, **how)

    def verdict(self, child: processes.Child, seconds: float) -> dict[str, Any]:
        """What the check has written, when it has ended."""
        self.graph.wait_for(lambda: child.exit_code is not None, seconds, "the verdict")
        assert self.out.is_file(), child.log_tail()
        found: dict[str, Any] = json.loads(self.out.read_text("utf-8"))
        print(found["text"])
        return found


@pytest.fixture
def bench(ros_graph: RosGraph, rospy_node: str, tmp_path: Path) -> Iterator[Bench]:
    made = Bench(ros_graph, tmp_path / "verdict.json")
    yield made
    for endoscope in made.made:
        endoscope.close()


@pytest.mark.parametrize("cause", list(WIRINGS) if FULL else ["none"])
def test_the_wiring_is_judged_on_the_topics(cause: str, bench: Bench) -> None:
    child = bench.start(cause, enable=True)["/check_frames"]
    found = bench.verdict(child, 240.0)
    assert found["cause"] == cause, found["text"]
    assert child.exit_code == (0 if cause == "none" else 1)


@pytest.mark.skipif(not FULL, reason="ten seconds: SURG_TEST_FULL=1 runs it")
def test_an_arm_that_is_not_enabled_is_left_alone(bench: Bench) -> None:
    child = bench.start(enable=False)["/check_frames"]
    found = bench.verdict(child, 90.0)
    assert child.exit_code == 1
    assert found["outcome"] == "cannot_tell"
    assert "is DISABLED; enable it first" in found["text"]


@pytest.mark.parametrize("arm", ["PSM1", "ECM"] if FULL else ["PSM1"])
def test_a_controller_that_dies_ends_the_check(arm: str, bench: Bench) -> None:
    children = bench.start(enable=True, lockstep=False)
    child = children["/check_frames"]
    bench.graph.wait_for(lambda: "the tip must now go" in child.log_tail(), 90.0, "the check")
    children[f"/{arm}/controller"].send(signal.SIGKILL)
    found = bench.verdict(child, 20.0)
    assert child.exit_code == 1
    assert f"{arm} is silent" in found["text"]
