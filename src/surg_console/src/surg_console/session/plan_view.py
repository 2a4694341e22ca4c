"""What a policy plans and sees, as a page draws it over the left eye's picture."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from surg_core import ConfigError
from surg_core.config import Cell
from surg_core.held_endoscope import HeldEndoscope, held_endoscope
from surg_core.pictures.eye_projection import EyeProjection
from surg_core.pictures.plan_projection import plan_pixels
from surg_core.transforms import FloatArray

LEFT = "endoscope.left"
"""End of the key of the picture that a page shows."""
NO_SCOPE = "No arm holds the endoscope, so the plan has no place in the picture."
NO_LENS = "The endoscope's lens is not known, so the plan has no place in the picture."
NO_JOINTS = "The arms are silent, so the plan has no place in the picture."


class PlanView:
    """Plans of a cell's arms in the picture of its endoscope."""

    def __init__(self, cell: Cell) -> None:
        self.held: HeldEndoscope | None = held_endoscope(cell)

    def as_json(
        self,
        plan: Any,
        frames: Mapping[str, FloatArray],
        q_scope: FloatArray | None,
        eye: EyeProjection | None,
    ) -> dict[str, Any]:
        """A plan; all places are shares of the picture, from its left upper corner.

        Args:
            plan: A surg_msgs/PolicyPlan.
            frames: X_WR (4, 4) of each arm that is heard.
            q_scope: (n,) joints of the arm that holds the endoscope [rad]; None: not known.
            eye: Lens of the left eye; None: not known.
        """
        paths, note = self._paths(plan, frames, q_scope, eye)
        here = not plan.picture or plan.picture.endswith(LEFT)
        points = zip(plan.keypoints, plan.x, plan.y, plan.certainty, strict=False)
        return {
            "say": "plan",
            "seq": plan.seq,
            "stamp_us": plan.header.stamp.to_nsec() // 1000,
            "paths": paths,
            "note": note,
            "phase": plan.phase,
            "confidence": plan.confidence if math.isfinite(plan.confidence) else None,
            "keypoints": [
                {"name": name, "at": [round(x, 4), round(y, 4)], "certainty": round(c, 3)}
                for name, x, y, c in (points if here else ())
            ],
            "attention": _attention(plan) if here else None,
            "counts": {
                name: getattr(plan, name)
                for name in ("accepted", "clipped", "rejected", "late", "stale")
            },
            "rule": plan.rule,
            "text": plan.text,
        }

    def _paths(
        self,
        plan: Any,
        frames: Mapping[str, FloatArray],
        q_scope: FloatArray | None,
        eye: EyeProjection | None,
    ) -> tuple[list[dict[str, Any]], str]:
        """The planned way of each arm's tip, and why there is none."""
        if self.held is None:
            return [], NO_SCOPE
        if eye is None:
            return [], NO_LENS
        planned = planned_tips(plan)
        if q_scope is None or not set(planned) <= set(frames):
            return [], NO_JOINTS
        try:
            X_WV = self.held.poses(q_scope[None])[0]
        except ConfigError as error:
            return [], str(error)
        size = np.array(eye.size)
        paths = []
        for arm, p_R in planned.items():
            shares = (plan_pixels(p_R, frames[arm], X_WV, eye) + 0.5) / size
            paths.append({"arm": arm, "points": [_place(share) for share in shares]})
        return paths, ""


def planned_tips(plan: Any) -> dict[str, FloatArray]:
    """Planned tips (K, 3) of each arm of a surg_msgs/PolicyPlan, in its rcm frame [m]."""
    names = list(plan.names)
    if not names or len(plan.values) != plan.rows * len(names):
        return {}
    rows = np.reshape(plan.values, (plan.rows, len(names)))
    arms = dict.fromkeys(name.rpartition("/")[0] for name in names)
    found = {}
    for arm in arms:
        columns = [f"{arm}/{axis}" for axis in "xyz"]
        if set(columns) <= set(names):
            found[arm] = rows[:, [names.index(column) for column in columns]]
    return found


def _place(share: FloatArray) -> list[float] | None:
    return np.round(share, 4).tolist() if np.isfinite(share).all() else None


def _attention(plan: Any) -> dict[str, Any] | None:
    data = bytes(plan.attention)
    if not data or len(data) != plan.map_rows * plan.map_columns:
        return None
    return {
        "rows": plan.map_rows,
        "columns": plan.map_columns,
        "area": [round(each, 4) for each in plan.area],
        "data": base64.b64encode(data).decode(),
    }
