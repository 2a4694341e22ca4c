"""The link to an arm as processes: driver, node, controller, operator."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import JointState

import surg_core
from crtk_msgs.msg import StringStamped
from helpers.graph.ros import RosGraph
from helpers.hardware.emulated_cell import deviation
from surg_cli.commands.arms.robot import lags_of
from surg_cli.graph import system
from surg_cli.graph.processes import Child, wait_until
from surg_cli.host import link_environments
from surg_emulators.franka import franka_kinematics
from surg_msgs.msg import Cycle, LinkStatus


def _granted() -> bool:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except OSError:
        return False
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return True


REAL_TIME = _granted()
"""Whether SCHED_FIFO is granted; figures without it say nothing of a link."""


class ArmGraph:
    """Link, controller and operator of one arm, and what the arm does.

    Attributes:
        joints: What the robot said of its joints, in the whole run.
        played: Of each of them, whether the motion was being played.
        lag: Of the link, as the controller measures it [s]; NaN: not known yet.
    """

    def __init__(self, graph: RosGraph, cell: Path) -> None:
        self.graph, self.cell = graph, cell
        self.arm = surg_core.load_cell(cell).arms["PSM1"]
        link_environments.make_ready(self.arm)
        params: dict[str, object] = {"cell": cell, "arm": "PSM1"}
        self.link = graph.node("surg_hardware", "link_node", "/PSM1/link", params)
        controller = {**params, "mode": "freerun", "realtime": REAL_TIME, "participants": []}
        self.controller = graph.node("surg_control", "rcm_node", "/PSM1/controller", controller)
        for child in (self.link, self.controller):
            system.prefer(child)
        self.status: LinkStatus | None = None
        self.cycle: Cycle | None = None
        self.joints: list[tuple[float, ...]] = []
        self.played: list[bool] = []
        self._out = rospy.Publisher("/PSM1/robot/request", StringStamped, queue_size=1)
        self._ears = [
            rospy.Subscriber("/PSM1/robot/status", LinkStatus, self._on_status),
            rospy.Subscriber("/PSM1/robot/measured_js", JointState, self._on_joints),
            rospy.Subscriber("/PSM1/cycle", Cycle, self._on_cycle, tcp_nodelay=True),
            rospy.Subscriber("/diagnostics", DiagnosticArray, self._on_diagnostics),
        ]
        self.lag = math.nan
        graph.wait_for(
            lambda: self.condition == LinkStatus.READY and self.cycle is not None, 20.0, "the link"
        )

    def _on_status(self, message: LinkStatus) -> None:
        self.status = message

    def _on_cycle(self, message: Cycle) -> None:
        self.cycle = message

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for found in lags_of(message.status).values():
            self.lag = found.measured

    def _on_joints(self, message: JointState) -> None:
        self.joints.append(tuple(message.position))
        cycle = self.cycle
        self.played.append(
            cycle is not None and cycle.command == Cycle.SERVO_CP and cycle.state == Cycle.ENABLED
        )

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

    def play(self, seconds: float) -> Child:
        """Play the bundled motion to its end; returns the operator, which has ended."""
        operator = self.operator(duration=seconds)
        self.graph.wait_for(lambda: operator.exit_code is not None, seconds + 60.0, "the operator")
        return operator

    def moving(self) -> bool:
        """Whether the controller commands a motion."""
        return self.cycle is not None and float(np.abs(self.cycle.qd_command).max()) > 0.02

    def driver(self) -> int:
        """Process id of the driver, the node's only child."""
        pid = self.link.process.pid
        return int(Path(f"/proc/{pid}/task/{pid}/children").read_text().split()[0])

    def deviations(self) -> np.ndarray:
        """Of a Franka's shaft from the trocar [m] at every state, by the maker's table."""
        return deviation(self.arm, franka_kinematics.flange(np.array(self.joints)))
