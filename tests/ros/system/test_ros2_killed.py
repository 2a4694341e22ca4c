"""ROS 2 processes that are killed while they command an arm, or while another one does."""

from __future__ import annotations

import resource
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import rospy
from geometry_msgs.msg import PoseStamped

from helpers.graph.crtk_client import Arm, WallTime
from helpers.graph.ros import RosGraph
from helpers.results.ros2_results import note
from helpers.ros2 import drawn_messages as drawn
from helpers.ros2.dds_peers import POSE, Dds
from surg_cli.graph import master
from surg_cli.graph.processes import Child
from surg_cli.host import paths
from surg_msgs.msg import Cycle

pytest.importorskip("cyclonedds", reason="missing: ./surg dev setup --all installs cyclonedds")
pytestmark = [pytest.mark.ros, pytest.mark.full]

WAIT_S = 90.0
KILLED = 1000
"""Processes that are killed while another one drives."""
LEAST = 0.5
"""Part of them that must have got as far as a node of ROS 1."""
DRIVERS = 50
"""Processes that drive an arm and are killed, one after another."""
CYCLE_S = 0.002
"""[s] Of control."""
HOLD_S = 0.15
"""[s] `servo_timeout`, and what a busy machine adds."""
REST_S = 0.5
"""[s] Of rest, after which the arm is free (F26)."""
PERIOD_S, SLOWLY_S = 0.02, 0.05
"""[s] Between the commands of one that drives, and of one that is killed beside it."""
GROWTH_MB = 5.0
"""More than that is no noise of the allocator."""
LOOK_S = 1.0


class Driven:
    """An arm in real time: whom it obeys, and how long it waits for a sender that is silent."""

    def __init__(self, graph: RosGraph) -> None:
        shared: dict[str, object] = {"cell": paths.ROOT / "cells" / "sim_ur5e", "mode": "freerun"}
        graph.node("surg_sim", "bridge_node.py", "/sim", shared)
        graph.node("surg_control", "rcm_node", "/PSM1/controller", {**shared, "arm": "PSM1"})
        self.obeyed: dict[str, int] = {}
        """Poses that were obeyed, by sender."""
        self.crossed: list[str] = []
        """Senders that were obeyed while another one held the arm."""
        self._holder, self._free = "", True
        self.silences: list[float] = []
        """[s] From the last of them to the last cycle that waited for another, less the time for
        which the controller itself got no processor: nobody was silent to it then."""
        self.begun_anew = -1
        """How often it got no processor for some time, or for another reason let go."""
        self.now, self._last, self._late, self._graph = Cycle(), 0.0, 0.0, graph
        self._arm = Arm("PSM1", WallTime())
        keys = {"queue_size": None, "tcp_nodelay": True}
        self._ear = rospy.Subscriber("/PSM1/cycle", Cycle, self._on_cycle, **keys)
        self._arm.check_connections(WAIT_S)
        self.ready()
        self.stay = drawn.cdr(POSE, PoseStamped(pose=self._arm.get("setpoint_cp", 1.0, 1.0).pose))

    def _on_cycle(self, cycle: Cycle) -> None:
        before, self.now = self.now, cycle
        new = cycle.accepted - before.accepted
        now = cycle.header.stamp.to_sec()
        self._late += max(0.0, now - before.header.stamp.to_sec() - CYCLE_S)
        self._free |= cycle.state != Cycle.ENABLED or now - self._last > REST_S
        if cycle.command == Cycle.SERVO_CP and new:
            self.obeyed[cycle.source] = self.obeyed.get(cycle.source, 0) + new
            if cycle.source != self._holder and not self._free:
                self.crossed.append(cycle.source)
            self._holder, self._free, self._last, self._late = cycle.source, False, now, 0.0
        elif before.command == Cycle.SERVO_CP != cycle.command and cycle.state == Cycle.ENABLED:
            self.silences.append(max(0.0, now - self._last - self._late - CYCLE_S))

    def ready(self) -> None:
        """Enable and home it if it is not."""
        if self.now.state != Cycle.ENABLED or not self.now.homed:
            self.begun_anew += 1
            arm = self._arm
            home = lambda: arm.enable(2.0) and arm.home(2.0)  # noqa: E731
            self._graph.wait_for(home, WAIT_S, "home")

    def by(self, name: str) -> bool:
        """Whether this sender drives it."""
        self.ready()
        return self.now.command == Cycle.SERVO_CP and self.now.source.startswith(name)

    def close(self) -> None:
        """Leave the graph."""
        self._ear.unregister()
        self._arm.close()


@pytest.fixture
def driven(ros_graph: RosGraph, rospy_node: str) -> Iterator[Driven]:
    arm = Driven(ros_graph)
    yield arm
    arm.close()


def test_killed_processes_leave_nothing_and_cross_nobodys_authority(
    ros_graph: RosGraph, driven: Driven
) -> None:
    dds = Dds(ros_graph)
    node, stay = dds.gateway(), driven.stay.hex()
    dds.peer("good", stay, period=PERIOD_S)
    ros_graph.wait_for(lambda: driven.by("/ros2_good"), WAIT_S, "the good one to drive")
    dying = dds.peer("dies", stay, period=SLOWLY_S, env={"PEER_KILLED": str(KILLED)})
    sizes, refused = [resident(node)], driven.now.refused
    while dying.exit_code is None:
        time.sleep(LOOK_S)
        driven.ready()
        sizes.append(resident(node))
    assert dying.log.read_text().split().count("killed") == KILLED
    gone = lambda: not [n for n in master.nodes(ros_graph.uri) if n.startswith("/ros2_dies")]  # noqa: E731
    ros_graph.wait_for(gone, WAIT_S, "the nodes of the killed to end")
    known = node.log.read_text("utf-8", "replace").count("sends commands as /ros2_dies")
    after = sizes[len(sizes) // 10 :]
    print(
        f"{known} of them known, {driven.now.refused - refused} commands refused, "
        f"{driven.obeyed}, begun anew {driven.begun_anew}"
    )
    longest = 1e3 * max(driven.silences, default=0.0)
    note(
        "killed senders",
        KILLED,
        f"{known} got a node, none another's arm; held within {longest:.0f} ms of silence; "
        f"{min(after):.0f} to {max(after):.0f} MB",
    )
    assert driven.crossed == [] and max(driven.obeyed, key=driven.obeyed.get) == "/ros2_good"
    assert driven.now.refused > refused and known > LEAST * KILLED
    assert longest < 1e3 * HOLD_S
    assert max(after) < min(after) + GROWTH_MB
    assert node.exit_code is None


def test_the_arm_holds_when_its_driver_is_killed(ros_graph: RosGraph, driven: Driven) -> None:
    dds = Dds(ros_graph)
    node = dds.gateway()
    for k in range(DRIVERS):
        driver = dds.peer("drives", driven.stay.hex(), label=str(k), period=PERIOD_S)
        ros_graph.wait_for(lambda: driven.by("/ros2_drives"), WAIT_S, f"driver {k}")
        driver.send(signal.SIGKILL)
        held = lambda: driven.now.command != Cycle.SERVO_CP  # noqa: E731
        ros_graph.wait_for(held, WAIT_S, "the arm to hold")
    said = f"silent {1e3 * max(driven.silences):.0f} ms at most until the arm holds"
    note("drivers killed", len(driven.silences), said)
    assert len(driven.silences) > DRIVERS // 2 and max(driven.silences) < HOLD_S
    assert node.exit_code is None


def resident(child: Child) -> float:
    """Memory of a process [MB]."""
    pages = int(Path(f"/proc/{child.process.pid}/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6
