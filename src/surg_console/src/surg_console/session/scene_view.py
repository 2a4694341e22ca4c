"""The arms of a cell in the room as capsules, for the page's view of the scene."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np

from surg_core import ArmShape, axis_angle_to_matrix, make_pose
from surg_core.config import Arm, Cell
from surg_core.transforms import FloatArray

THIN = 0.02
"""[m] Radius of a link of which only its joints are known."""
SHAFT = 0.005
"""[m] Radius of an instrument of which only its tip is known."""


class SceneView:
    """Every arm where its joints, its URDF and the cell put it."""

    def __init__(self, cell: Cell) -> None:
        self._arms = {name: ArmCapsules(arm) for name, arm in cell.arms.items()}

    @property
    def joints(self) -> dict[str, list[str]]:
        """Names of each arm's joints, in order."""
        return {name: list(each.arm.robot.joint_names) for name, each in self._arms.items()}

    def as_json(self, joints: Mapping[str, FloatArray]) -> dict[str, Any]:
        """The scene in the world [m, rounded to 0.1 mm].

        Args:
            joints: (n,) of each arm whose joints are known [rad].

        Returns:
            `arms`: name, capsules (both ends and radius), tip, trocar; an arm that is silent is
            absent. `silent`: names of those.
        """
        arms = []
        for name, each in self._arms.items():
            q = joints.get(name)
            if q is None or len(q) != each.arm.chain.dof or not np.isfinite(q).all():
                continue
            capsules = each.placed(q)
            arm = each.arm
            tip = (arm.X_WB @ np.asarray(arm.chain.forward(q)) @ [*arm.tool.p_FTip, 1.0])[:3]
            trocar = (arm.X_WB @ [*arm.trocar.p_BRcm, 1.0])[:3]
            arms.append(
                {
                    "name": name,
                    "scope": arm.instrument.camera is not None,
                    "capsules": np.round(capsules, 4).tolist(),
                    "tip": np.round(tip, 4).tolist(),
                    "trocar": np.round(trocar, 4).tolist(),
                }
            )
        known = {arm["name"] for arm in arms}
        return {"say": "scene", "arms": arms, "silent": [n for n in self._arms if n not in known]}


class ArmCapsules:
    """An arm as capsules: those of its file, else from joint to joint."""

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        self._shape = (
            ArmShape(arm.name, arm.chain, arm.X_WB, arm.robot, arm.instrument, arm.tool)
            if arm.robot.capsules
            else None
        )

    def placed(self, q: FloatArray) -> FloatArray:
        """(n, 7) both ends in the world and radius [m] at joints (n,) [rad]."""
        if self._shape is not None:
            return np.asarray(self._shape.placed(q))
        arm, X = self.arm, np.asarray(self.arm.X_WB)
        points = [X[:3, 3]]
        for joint, angle in zip(arm.chain.joints, q, strict=True):
            turned = axis_angle_to_matrix(joint.axis, float(angle))
            X = X @ joint.X_PJ @ make_pose(np.zeros(3), turned)
            points.append(X[:3, 3])
        X_WF = X @ arm.chain.X_LF
        points.append(X_WF[:3, 3])
        rows = [[*a, *b, THIN] for a, b in itertools.pairwise(points)]
        tip = (X_WF @ [*arm.tool.p_FTip, 1.0])[:3]
        return np.array([*rows, [*X_WF[:3, 3], *tip, SHAFT]])
