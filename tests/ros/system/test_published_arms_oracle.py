"""Arms that vendors describe in public, from URDF to demo: docs/reference/arms_tried.md.

A description is refused in one true sentence, or the arm's demo ends well: an arm that `check`
calls ready does not end in FAULT.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from xml.etree import ElementTree

import pytest

from helpers.control import published_arms
from helpers.control.published_arms import ARMS
from helpers.graph.surg import surg
from helpers.results.results_page import ResultsPage
from surg_cli.host import paths

pytestmark = [pytest.mark.ros, pytest.mark.oracle, pytest.mark.untimed]

PAGE = ResultsPage("arms_tried.md", folder=paths.ROOT / "docs" / "reference")
MEAN, MOST = 0.03, 0.3
"""[mm] Deviation of a demo from its pivot, as the main job allows it."""


@pytest.mark.parametrize("name", ARMS)
def test_an_arm_that_is_called_ready_plays_the_demo(name: str, tmp_path: Path) -> None:
    arm = ARMS[name]
    trial = published_arms.begin(name, arm, tmp_path)
    root = ElementTree.parse(tmp_path / f"{name}.urdf").getroot()
    mass = math.fsum(float(element.get("value", "0")) for element in root.iter("mass"))
    names = trial.joints["names"]
    assert isinstance(names, list)
    made = [arm.vendor, arm.source, str(len(names)), f"{mass:.0f}" if mass else "none"]
    refused = trial.find_home()
    if refused:
        assert arm.refused and arm.refused in refused, refused
        PAGE.note(name, None, " | ".join([*made, "none", arm.refused, "", ""]))
        return
    robot = trial.write()
    checked = surg("robot", "check", robot)
    assert checked.returncode == 0, checked.stderr
    acceleration = f"{trial.tip_acceleration:g}"
    done = surg("demo", "--robot", robot, "--no-video", "--out", tmp_path / "run", timeout_s=1800.0)
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "run" / "summary.json").read_text("utf-8"))
    off = summary["rcm_kinematic_mm"]
    assert off["mean"] <= MEAN and off["max"] <= MOST
    figures = [f"{1e3 * off['mean']:.1f}", f"{1e3 * off['max']:.1f}"]
    PAGE.note(name, None, " | ".join([*made, acceleration, "ready", *figures]))
