"""What a policy plans and sees, as the page gets it: places are shares of the left picture."""

from __future__ import annotations

import base64
import json
import math
from typing import Any

import cv2
import numpy as np
import pytest

import surg_core
from helpers.endoscope_files import lens, pose
from surg_cli.host import paths
from surg_console.session.plan_view import PlanView
from surg_core.pictures.eye_projection import EyeProjection
from surg_msgs.msg import PolicyPlan

CELL = surg_core.load_cell(paths.CELLS / "sim_two_arms")
NAMES = [f"{arm}/{name}" for arm in ("PSM1", "ECM") for name in ("x", "y", "z", "roll", "jaw")]
LENS = lens("left")
EYE = EyeProjection(LENS, np.eye(4))


def plan(rows: np.ndarray, names: list[str] = NAMES, **more: Any) -> PolicyPlan:
    values = {"confidence": math.nan, "area": [0.0, 0.0, 1.0, 1.0], **more}
    return PolicyPlan(names=names, rows=len(rows), values=rows.ravel().tolist(), **values)


def scope() -> tuple[np.ndarray, np.ndarray]:
    """Joints of the arm with the endoscope, and where it then looks from, by the cell's parts."""
    view = PlanView(CELL)
    assert view.held is not None
    q = np.array(CELL.arms[view.held.arm].robot.home) + 0.02
    X_WF = view.held.X_WB @ np.asarray(view.held.chain.forward(q))
    return q, X_WF @ np.asarray(view.held.X_FV)


def test_each_arms_way_lies_where_opencv_projects_it() -> None:
    rng = np.random.default_rng(2)
    q, X_WV = scope()
    frames = {"PSM1": pose(rng), "ECM": pose(rng)}
    seen = rng.uniform([-0.02, -0.015, 0.06], [0.02, 0.015, 0.12], (8, 3))
    p_W = np.hstack([seen, np.ones((8, 1))]) @ X_WV.T
    p_R = {arm: (p_W @ np.linalg.inv(X).T)[:, :3] for arm, X in frames.items()}
    turn = np.zeros((8, 2))
    found = PlanView(CELL).as_json(
        plan(np.hstack([p_R["PSM1"], turn, p_R["ECM"] + [0, 0, -9], turn])), frames, q, EYE
    )
    json.dumps(found, allow_nan=False)
    first, second = found["paths"]
    pixels, _ = cv2.projectPoints(seen, np.zeros(3), np.zeros(3), LENS.K, LENS.D)
    expected = (pixels[:, 0] + 0.5) / (640, 480)  # a pixel's middle is half a pixel from its edge
    assert first["arm"] == "PSM1" and second["arm"] == "ECM" and found["note"] == ""
    np.testing.assert_allclose(first["points"], expected, atol=6e-5)
    assert second["points"] != first["points"]


@pytest.mark.parametrize("missing", ["lens", "joints", "arm", "scope"])
def test_without_its_parts_there_is_no_way_and_it_is_said(missing: str) -> None:
    q, _ = scope()
    cell = "sim_ur5e" if missing == "scope" else "sim_two_arms"
    view = PlanView(surg_core.load_cell(paths.CELLS / cell))
    frames = {} if missing == "arm" else {"PSM1": np.eye(4)}
    found = view.as_json(
        plan(np.ones((3, 5)), NAMES[:5]),
        frames,
        None if missing == "joints" else q,
        None if missing == "lens" else EYE,
    )
    assert found["paths"] == [] and found["note"]


def test_what_was_seen_and_refused_is_told() -> None:
    data = bytes(range(6))
    message = plan(
        np.ones((0, 5)),
        NAMES[:5],
        picture="observation.images.endoscope.left",
        phase="pulling",
        keypoints=["tip"],
        x=[0.25],
        y=[0.5],
        certainty=[0.75],
        map_rows=2,
        map_columns=3,
        attention=data,
        rejected=3,
        late=1,
        rule="step",
        text="too far",
    )
    found = PlanView(CELL).as_json(message, {}, None, None)
    assert found["keypoints"] == [{"name": "tip", "at": [0.25, 0.5], "certainty": 0.75}]
    assert base64.b64decode(found["attention"]["data"]) == data
    assert (found["attention"]["rows"], found["attention"]["columns"]) == (2, 3)
    assert found["phase"] == "pulling" and found["confidence"] is None
    assert found["counts"] == {"accepted": 0, "clipped": 0, "rejected": 3, "late": 1, "stale": 0}
    assert (found["rule"], found["text"]) == ("step", "too far")
    # Points of another picture than the page's are not drawn into it.
    message.picture = "observation.images.endoscope.right"
    other = PlanView(CELL).as_json(message, {}, None, None)
    assert other["keypoints"] == [] and other["attention"] is None and other["phase"] == "pulling"
    # A map whose size lies is no map.
    message.picture, message.map_rows = "", 3
    assert PlanView(CELL).as_json(message, {}, None, None)["attention"] is None
