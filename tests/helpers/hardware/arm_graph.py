"""The link to a Franka arm as processes: emulator, driver, node, controller, operator."""

from __future__ import annotations

import math
import os
import shutil
from pathlib import Path

import numpy as np
import rospy
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import JointState

import surg_core
from crtk_msgs.msg import StringStamped
from helpers.graph.ros import RosGraph
from surg_cli.commands.arms.robot import lags_of
from surg_cli.graph import system
from surg_cli.graph.processes import Child, wait_until
from surg_cli.host import link_environments, paths
from surg_hardware.emulators.franka import franka_kinematics
from surg_msgs.msg import LinkStatus


def cell_at(name: str, folder: Path, address: str, payload: dict[str, object]) -> Path:
    """A copy of a bundled cell at another address; returns its folder."""
    bundled = paths.CELLS / f"emulated_{name}"
    cell = folder / "cell"
    shutil.copytree(bundled, cell)
    document = yaml.safe_load((cell / "cell.yaml").read_text("utf-8"))
    arm = document["arms"]["PSM1"]
    arm["hardware"].update(address=address, payload=payload)
    for key in ("robot", "instrument"):
        arm[key] = os.path.normpath(bundled / arm[key])
    (cell / "cell.yaml").write_text(yaml.safe_dump(document), "utf-8")
    return cell


class Graph:
    """Link, controller and operator of one arm, and what the arm does.

    Attributes:
        joints: What the robot said of its joints, in the whole run.
        lag: Of the link, as the controller measures it [s]; NaN: not known yet.
    """

    def __init__(self, graph: RosGraph, cell: Path, realtime: bool) -> None:
        self.graph, self.cell = graph, cell
        self.arm = surg_core.load_cell(cell).arms["PSM1"]
        link_environments.make_ready(self.arm)
        params: dict[str, object] = {"cell": cell, "arm": "PSM1"}
        self.link = graph.node("surg_hardware", "link_node", "/PSM1/link", params)
        controller = {**params, "mode": "freerun", "realtime": realtime, "participants": []}
        self.controller = graph.node("surg_control", "rcm_node", "/PSM1/controller", controller)
        for child in (self.link, self.controller):
            system.prefer(child)
        self.status: LinkStatus | None = None
        self.joints: list[tuple[float, ...]] = []
        self._out = rospy.Publisher("/PSM1/robot/request", StringStamped, queue_size=1)
        self._ears = [
            rospy.Subscriber("/PSM1/robot/status", LinkStatus, self._on_status),
            rospy.Subscriber("/PSM1/robot/measured_js", JointState, self._on_joints),
        ]
        self.lag = math.nan
        self._ears.append(rospy.Subscriber("/diagnostics", DiagnosticArray, self._on_diagnostics))
        graph.wait_for(lambda: self.condition == LinkStatus.READY, 20.0, "the link")

    def _on_status(self, message: LinkStatus) -> None:
        self.status = message

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for found in lags_of(message.status).values():
            self.lag = found.measured

    def _on_joints(self, message: JointState) -> None:
        self.joints.append(tuple(message.position))

    @property
    def condition(self) -> int:
        """Of the robot, as the link says it; -1: it has said nothing."""
        return -1 if self.status is None else int(self.status.condition)

    def start(self) -> None:
        """Ask for it until the robot obeys: at first its states are too young."""

        def asked() -> bool:
            self._out.publish(StringStamped(string="start"))
            return wait_until(lambda: self.condition == LinkStatus.ACTIVE, 0.5)

        self.graph.wait_for(asked, 15.0, "the robot's start")

    def operator(self, **params: object) -> Child:
        """Play the bundled motion."""
        return self.graph.node(
            "surg_teleop", "operator_node", "/operator", {"cell": self.cell, **params}
        )

    def deviations(self) -> np.ndarray:
        """Of the shaft from the trocar [m] at every state, by the maker's table."""
        X = franka_kinematics.flange(np.array(self.joints))
        R, p = X[:, :3, :3], X[:, :3, 3]
        away = self.arm.trocar.p_BRcm - R @ self.arm.tool.p_FTip - p
        s = R @ self.arm.tool.s_F
        along = np.sum(away * s, axis=1, keepdims=True)
        return np.asarray(np.linalg.norm(away - along * s, axis=1))
