"""Arms that vendors describe in public, from URDF to demo: docs/reference/arms_tried.md.

An arm that `check` calls ready plays the demo to its end, within the bounds of the main job. Of
another the page says what the commands said.
"""

from __future__ import annotations

import json
import math
import re
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
SHORT = {
    r"a joint comes within (\S+) rad.*": r"\1 rad from a limit",
    r"(\d+ %) of a joint's (\w+) at .*": r"\1 of \2",
    r"(singular value \S+);.*": r"\1",
    r"the shaft is (\d+ deg).*": r"shaft at \1",
}
"""What `robot check` says -> what the page says."""


@pytest.mark.parametrize("name", ARMS)
def test_an_arm_that_is_called_ready_plays_the_demo(name: str, tmp_path: Path) -> None:
    arm, out = ARMS[name], tmp_path / "run"
    trial = published_arms.begin(name, arm, tmp_path)
    root = ElementTree.parse(tmp_path / f"{name}.urdf").getroot()
    mass = math.fsum(float(element.get("value", "0")) for element in root.iter("mass"))
    names = trial.joints["names"]
    assert isinstance(names, list)
    made = [str(len(names)), f"{mass:.0f}" if mass else "–"]
    nowhere = trial.find_home()
    reasons = [nowhere] if nowhere else trial.shortcomings()
    made.append(f"{trial.tip_acceleration:g}")
    given = ", ".join(made)
    if reasons:
        for long, short in SHORT.items():
            reasons = [re.sub(long, short, reason) for reason in reasons]
        PAGE.note(name, None, f"{given} | {', '.join(reasons)}")
        return
    done = surg("demo", "--robot", trial.write(), "--no-video", "--out", out, timeout_s=1800.0)
    assert done.returncode == 0, done.stderr
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    off = summary["rcm_kinematic_mm"]
    assert off["mean"] <= MEAN and off["max"] <= MOST
    PAGE.note(name, None, f"{given} | {1e3 * off['mean']:.1f}, {1e3 * off['max']:.1f}")
