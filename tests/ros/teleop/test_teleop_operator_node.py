"""The operator as a process, against a scripted arm: lock-step, free-run, exit codes."""

import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.graph.ros import RosGraph
from helpers.graph.statuses import sim_status
from surg_cli.host import paths

pytestmark = pytest.mark.ros

CELL = paths.ROOT / "cells/sim_ur5e"
PERIOD_NS = 2_000_000
COMMANDS = ("state_command", "move_cp", "servo_cp", "servo_jp", "jaw/servo_jp", "hold")


@dataclass
class ScriptedArm:
    """Controller and simulator in one: obeys in the next cycle, keeps what it heard.

    In lock-step it steps tick k when it holds Ready k and all the messages that Ready counts.
    """

    lockstep: bool
    ready: dict[int, Any] = field(default_factory=dict)
    heard: list[tuple[str, Any]] = field(default_factory=list)
    stepped: list[tuple[int, list[tuple[str, Any]]]] = field(default_factory=list)
    fault_at: int = 0
    changed: threading.Condition = field(default_factory=threading.Condition)

    def __post_init__(self) -> None:
        import rospy
        from geometry_msgs.msg import PoseStamped
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Empty

        from crtk_msgs.msg import StringStamped
        from surg_msgs.msg import Cycle, Ready, SenderStatus, SimStatus

        kinds = dict(
            zip(
                COMMANDS,
                (StringStamped, PoseStamped, PoseStamped, JointState, JointState, Empty),
                strict=True,
            )
        )
        self.state, self.homed, self.busy = 0, False, 0
        self.p = np.array([0.0, 0.0, 0.12])
        # Latched as the controller's: a publisher of rospy takes a reader up after telling it so.
        self.cycle = rospy.Publisher("/PSM1/cycle", Cycle, queue_size=0, latch=self.lockstep)
        self.link = rospy.Publisher("/PSM1/robot/measured_js", JointState, queue_size=0)
        self.status = rospy.Publisher("/sim/status", SimStatus, queue_size=0, latch=True)
        self.subscribers = [
            rospy.Subscriber(f"/PSM1/{name}", kind, self.hear, callback_args=name)
            for name, kind in kinds.items()
        ]
        self.subscribers.append(rospy.Subscriber("/sim/ready", Ready, self.on_ready))
        self.reports: list[SenderStatus] = []
        self.subscribers.append(
            rospy.Subscriber("/operator/status", SenderStatus, self.reports.append)
        )

    def hear(self, message: Any, name: str) -> None:
        with self.changed:
            self.heard.append((name, message))
            self.changed.notify_all()

    def on_ready(self, message: Any) -> None:
        with self.changed:
            self.ready[message.tick] = message
            self.changed.notify_all()

    def step(self, k: int, timeout: float = 60.0) -> bool:
        """One tick; returns whether the operator is done."""
        done = False
        if self.lockstep:
            with self.changed:
                assert self.changed.wait_for(
                    lambda: k in self.ready and len(self.heard) >= sum(self.ready[k].sent), timeout
                ), f"tick {k}: {len(self.heard)} heard, ready {sorted(self.ready)[-1:]}"
                done = self.ready[k].done
        with self.changed:
            batch = self.heard[sum(len(b) for _, b in self.stepped) :]
        self.stepped.append((k, batch))
        self.obey(batch)
        if k == self.fault_at:
            self.state = 3
        self.cycle.publish(self.message(k))
        return done

    def obey(self, batch: list[tuple[str, Any]]) -> None:
        self.busy = max(self.busy - 1, 0)
        for name, message in batch:
            if name == "state_command":
                self.homed |= message.string == "home"
                self.state = 1 if message.string == "enable" else self.state
            elif name in ("move_cp", "servo_cp"):
                position = message.pose.position
                self.p = np.array([position.x, position.y, position.z])
                self.busy = 20 if name == "move_cp" else 0

    def message(self, k: int) -> Any:
        import rospy

        from surg_msgs.msg import Cycle

        cycle = Cycle(tick=k, state=self.state, homed=self.homed, busy=self.busy > 0)
        cycle.header.stamp = rospy.Time(*divmod(k * PERIOD_NS, 10**9))
        cycle.reason = "rcm_error" if self.state == 3 else ""
        # A base frame turned and moved against the rcm frame: half a turn about x.
        cycle.p_rcm, cycle.q_br = [0.5, 0.1, 0.2], [1.0, 0.0, 0.0, 0.0]
        p_B = np.array(cycle.p_rcm) + np.array([1, -1, -1]) * self.p
        cycle.p_set, cycle.p_tip = p_B.tolist(), p_B.tolist()
        return cycle

    def close(self) -> None:
        for end in (*self.subscribers, self.cycle, self.link, self.status):
            end.unregister()


@pytest.fixture
def arm(rospy_node: str, request: pytest.FixtureRequest) -> Iterator[ScriptedArm]:
    scripted = ScriptedArm(lockstep=getattr(request, "param", True))
    yield scripted
    scripted.close()


def motion_file(folder: Path) -> Path:
    t = np.arange(61) * 0.02
    rows = np.column_stack((t, 0.01 * np.sin(t), 0.0 * t, 0.005 * t, 0.2 * t, 0.3 * t))
    path = folder / "motion.csv"
    header = "t_s,x_m,y_m,z_m,roll_rad,gripper_rad"
    np.savetxt(path, rows, delimiter=",", header=header, comments="")
    return path


def start(ros_graph: RosGraph, **parameters: object) -> Any:
    settings = {"cell": CELL, "lockstep": True, "motion": motion_file(ros_graph.folder)}
    return ros_graph.node("surg_teleop", "operator_node", "/operator", {**settings, **parameters})


def run_lockstep(ros_graph: RosGraph, arm: ScriptedArm, ticks: int = 5_000) -> int:
    for k in range(1, ticks):
        if arm.step(k):
            arm.status.publish(sim_status("DONE"))
            return k
    raise AssertionError(f"not done after {ticks} ticks; last report {arm.reports[-1:]}")


@pytest.mark.untimed
def test_lockstep_from_connection_to_done(ros_graph: RosGraph, arm: ScriptedArm) -> None:
    child = start(ros_graph)
    last = run_lockstep(ros_graph, arm)
    assert child.process.wait(10) == 0
    names = [name for _, batch in arm.stepped for name, _ in batch]
    assert names.count("move_cp") == 1
    assert [m.string for n, m in arm.heard if n == "state_command"] == ["home", "enable"]
    assert arm.stepped[0] == (1, [])  # nothing is known in tick 1, so nothing is asked
    streamed = [(k, m) for k, batch in arm.stepped for n, m in batch if n == "servo_cp"]
    assert [k for k, _ in streamed] == list(range(streamed[0][0], streamed[-1][0] + 1))
    # A command is stamped for the very tick in which it is obeyed.
    assert all(m.header.stamp.to_nsec() == k * PERIOD_NS for k, m in streamed)
    assert names[-1] == "hold"
    assert arm.ready[last].done
    report = arm.reports[-1]
    assert report.stage == report.STAGE_DONE
    first, end = report.begin.to_nsec(), report.end.to_nsec()
    assert end - first == pytest.approx(1.2e9, abs=2)
    assert first > streamed[0][0] * PERIOD_NS


def test_a_fault_is_the_end(ros_graph: RosGraph, arm: ScriptedArm) -> None:
    arm.fault_at = 300
    child = start(ros_graph)
    assert run_lockstep(ros_graph, arm) == 301
    assert child.process.wait(10) == 1
    assert "the arm is in FAULT: rcm_error" in child.log_tail(5)
    assert arm.reports[-1].stage == arm.reports[-1].STAGE_FAILED


@pytest.mark.parametrize("arm", [False], indirect=True)
def test_free_run_follows_the_cycles_stamps(ros_graph: RosGraph, arm: ScriptedArm) -> None:
    child = start(ros_graph, lockstep=False)
    ros_graph.wait_for(lambda: bool(arm.reports), 20, "the operator's connections")
    for k in range(1, 6_000):
        arm.step(k)
        if child.process.poll() is not None:
            break
        threading.Event().wait(0.001)
    assert child.process.wait(10) == 0
    stamps = [m.header.stamp.to_nsec() for n, m in arm.heard if n == "servo_cp"]
    assert (np.diff(stamps) > 0).all()
    assert stamps[-1] - stamps[0] >= 1.2e9
    assert arm.ready == {}


@pytest.mark.untimed
def test_a_constant_motion_is_refused_before_anything_moves(
    ros_graph: RosGraph, arm: ScriptedArm
) -> None:
    motion = ros_graph.folder / "constant.csv"
    motion.write_text("t_s,x_m,y_m,z_m\n" + "".join(f"{0.1 * i},0,0,0\n" for i in range(20)))
    child = start(ros_graph, motion=motion)
    assert child.process.wait(20) == 1
    assert "the motion is constant" in child.log_tail(5)
    assert arm.heard == []
