"""Performs one stop of the rehearsal on a running arm: listens, lets it move, kills, measures."""

from __future__ import annotations

import datetime
import math
import os
import signal
import subprocess
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from surg_cli.graph import master, processes
from surg_cli.graph.running import System
from surg_cli.host.terminal import CliError, say
from surg_cli.robots import rehearsal
from surg_cli.robots.rehearsal import RehearsalOutcome, RehearsalStep, Trace
from surg_cli.robots.robot_request import condition_name

SCALE = 0.8
"""Of the bundled motion: its tip then moves at about 10 mm/s."""
MOVING = 0.005
"""[m/s] Set-point of the tip: the arm moves as the rehearsal wants it."""
BRING_UP_S, PERSON_S, AFTER_S = 60.0, 120.0, 2.0
"""[s] To enable, home and move; for a person to act; recorded after the event."""
HEARD_S, RETRY_S = 10.0, 0.5
"""[s] For the controller's first word; between two requests."""
GONE_S = 0.1
"""[s] Without a joint state: the robot has stopped, as far as anybody can tell."""


class Record:
    """What a link says of its arm, at the times of the robot: a busy machine hears it late.

    Attributes:
        stopped_at: When the link first left ACTIVE [s]; None: it has not.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._times: list[float] = []
        self._q: list[tuple[float, ...]] = []
        self._speeds: list[float] = []
        self._heard = math.nan  # our steady clock
        self._known = False
        self.stopped_at: float | None = None

    def state(self, stamp: float, q: Sequence[float], qd: Sequence[float]) -> None:
        """Take joint angles and velocities, and when the robot was there [s]."""
        with self._lock:
            self._times.append(stamp)
            self._q.append(tuple(q))
            self._speeds.append(max((abs(float(rate)) for rate in qd), default=0.0))
            self._heard = time.monotonic()

    def status(self, stamp: float, active: bool) -> None:
        """Take whether the arm obeys, and of which state that was said [s]."""
        if active:
            self.stopped_at = None
        elif self.stopped_at is None and self._known:
            self.stopped_at = stamp
        self._known = True

    @property
    def silent(self) -> bool:
        """Whether no joint state comes any more."""
        with self._lock:
            return time.monotonic() - self._heard > GONE_S

    @property
    def newest(self) -> float:
        """When the newest state was [s]."""
        with self._lock:
            return self._times[-1]

    def since(self, moment: float) -> tuple[list[float], np.ndarray, list[float]]:
        """Times [s], angles [rad] and speeds of the fastest joint [rad/s] since a moment [s]."""
        with self._lock:
            first = next((n for n, at in enumerate(self._times) if at >= moment), len(self._times))
            return self._times[first:], np.array(self._q[first:]), self._speeds[first:]


class Listener:
    """What link and controller of one arm say; rospy has been initialised."""

    def __init__(self, arm: Any) -> None:
        import rospy
        from sensor_msgs.msg import JointState

        from crtk_msgs.msg import StringStamped
        from surg_msgs.msg import Cycle, LinkStatus

        self._arm, self.record = arm, Record()
        self.status: Any = None
        self.cycle: Any = None
        self.fault = ""  # the controller's first FAULT
        name, keys = arm.name, {"queue_size": 1000, "tcp_nodelay": True}
        self._word = StringStamped
        self._out = rospy.Publisher(f"/{name}/state_command", StringStamped, queue_size=1)
        rospy.Subscriber(f"/{name}/robot/measured_js", JointState, self._on_state, **keys)
        rospy.Subscriber(f"/{name}/robot/status", LinkStatus, self._on_status, **keys)
        rospy.Subscriber(f"/{name}/cycle", Cycle, self._on_cycle, **keys)

    def _on_state(self, message: Any) -> None:
        self.record.state(message.header.stamp.to_sec(), message.position, message.velocity)

    def _on_status(self, message: Any) -> None:
        self.record.status(message.header.stamp.to_sec(), condition_name(message) == "ACTIVE")
        self.status = message

    def _on_cycle(self, message: Any) -> None:
        if message.state == message.FAULT and not self.fault:
            self.fault = message.reason
        self.cycle = message

    def leave_fault(self) -> None:
        """Disable a controller that is still in FAULT from the last stop.

        Raises:
            CliError: It stays in FAULT, or says nothing.
        """

        def left() -> bool:
            if self.cycle is not None and self.cycle.state == self.cycle.FAULT:
                self._out.publish(self._word(string="disable"))
                processes.wait_until(lambda: self.cycle.state != self.cycle.FAULT, RETRY_S)
            return self.cycle is not None and self.cycle.state != self.cycle.FAULT

        if not processes.wait_until(left, HEARD_S):
            raise CliError(f"{self._arm.name}: the controller does not answer: see ./surg status")
        self.fault = ""

    @property
    def moves(self) -> bool:
        """Whether the arm is driven at the rehearsal's speed."""
        return (
            self.cycle is not None
            and self.status is not None
            and condition_name(self.status) == "ACTIVE"
            and float(np.linalg.norm(self.cycle.v_set)) > MOVING
        )

    def trace(self, since: float) -> Trace:
        """Everything since a moment of the robot's time."""
        times, q, speeds = self.record.since(since)
        deviations = _deviations(self._arm, q) if len(q) else []
        condition = "" if self.status is None else condition_name(self.status)
        return Trace(times, speeds, deviations, condition, self.fault)


def _deviations(arm: Any, q: np.ndarray) -> list[float]:
    """Of the shaft from the cell's trocar [m]."""
    X_BF = np.asarray(arm.chain.forward_batch(q))
    away = arm.trocar.p_BRcm - X_BF[:, :3, :3] @ arm.tool.p_FTip - X_BF[:, :3, 3]
    s_B = X_BF[:, :3, :3] @ arm.tool.s_F
    along = np.sum(away * s_B, axis=1, keepdims=True)
    distances: list[float] = np.linalg.norm(away - along * s_B, axis=1).tolist()
    return distances


def perform(system: System, arm: Any, folder: Path, step: RehearsalStep) -> RehearsalOutcome:
    """Let the arm move, let the stop happen, and measure it.

    Raises:
        CliError: The arm does not move, or nobody acts.
    """
    with master.joined(system.master_uri, "surg_rehearse"):
        listener = Listener(arm)
        listener.leave_fault()
        operator = _operator(system, arm, folder)
        try:
            if not processes.wait_until(lambda: listener.moves, BRING_UP_S):
                said = "" if listener.status is None else listener.status.fault
                raise CliError(
                    f"{arm.name} does not move: {said or 'no link'}. It must be started: "
                    f"./surg robot {folder.name} start"
                )
            event = _await_event(listener, system, arm, step)
            time.sleep(AFTER_S)
        finally:
            operator.terminate()
            operator.wait()
        serial = "" if listener.status is None else listener.status.serial
        date = datetime.date.today().isoformat()
        return rehearsal.judge(step, event, listener.trace(event - 0.1), date, serial)


def _operator(system: System, arm: Any, folder: Path) -> subprocess.Popen[bytes]:
    """The bundled motion, slowly, in a process of its own."""
    words = [f"_cell:={folder}", f"_arm:={arm.name}", f"_scale:={SCALE}"]
    return subprocess.Popen(
        ["rosrun", "surg_teleop", "operator_node.py", "__name:=rehearsal_operator", *words],
        env={**os.environ, "ROS_MASTER_URI": system.master_uri},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
    )


def _await_event(listener: Listener, system: System, arm: Any, step: RehearsalStep) -> float:
    """The moment of the stop, on the clock of the robot's stamps.

    Raises:
        CliError: Nobody has acted, or there is no such process.
    """
    if step.victim:
        pid = _victim(system, arm.name, step.victim)
        moment = time.time()
        os.kill(pid, signal.SIGKILL)
        return moment
    say(f"{step.name}: now {step.do}.")
    record = listener.record
    stopped = processes.wait_until(lambda: record.stopped_at is not None or record.silent, PERSON_S)
    if not stopped:
        raise CliError(f"{step.name}: nothing has happened within {PERSON_S:g} s")
    return record.stopped_at or record.newest


def _victim(system: System, arm: str, victim: str) -> int:
    """The process id of a node or of the link's driver.

    Raises:
        CliError: There is none.
    """
    node = f"/{arm}/{'controller' if victim == 'controller' else 'link'}"
    pid = system.nodes.get(node)
    if pid is None:
        raise CliError(f"{node} does not run in the system of {system.cell}")
    if victim != "driver":
        return pid
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text("ascii").split()
    if not children:
        raise CliError(f"{node} has no driver")
    return int(children[0])
