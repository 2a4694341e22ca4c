"""A simulated arm in real time, a model server, and policies in processes of their own."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rospy
from sensor_msgs.msg import Image
from std_msgs.msg import Bool

from crtk_msgs.msg import StringStamped
from helpers.graph.ros import RosGraph
from helpers.graph.statuses import TeleopSpeaker
from surg_cli.graph import master, system
from surg_cli.graph.processes import Child
from surg_cli.graph.system_plan import SystemPlan
from surg_cli.host import paths
from surg_core.status_check import value_name
from surg_msgs.msg import Cycle, PolicyAction, PolicyStatus

CELL = paths.ROOT / "cells" / "sim_ur5e"
CIRCLE = Path(__file__).with_name("circle_policy.py")
CAMERA = "test_left"
CAMERA_RATE = 20.0


@dataclass(frozen=True)
class Seen:
    """One control cycle as it came.

    Attributes:
        at: Receipt on the steady clock [s].
        tick: The controller's own count.
        p_set: Set-point of the tip [m].
        p_tip: Measured tip [m].
        rcm_error: Distance of the shaft from its pivot [m].
        state: Operating state.
        source: Who holds the arm.
        period_us: Since the cycle before.
    """

    at: float
    tick: int
    p_set: np.ndarray
    p_tip: np.ndarray
    rcm_error: float
    state: int
    source: str
    period_us: float


class PolicyRig:
    """The graph, and this process's ears and hands in it.

    Args:
        graph: A private graph.
        cell: Folder of a cell with one arm, PSM1.
        nodes: Brings the arm up; default: the simulator and its controller.
        address: Of the server; default: a free port.
        server: Further parameters of the model server.
    """

    def __init__(
        self,
        graph: RosGraph,
        cell: Path = CELL,
        nodes: Callable[[RosGraph], None] | None = None,
        address: str = "",
        **server: object,
    ) -> None:
        self.graph, self.cell = graph, cell
        self.address = address or f"tcp://127.0.0.1:{master.free_port()}"
        (nodes or self._simulator)(graph)
        params: dict[str, object] = {
            "cell": cell,
            "bind": self.address,
            "need_teleop": False,
            **server,
        }
        self.server = graph.node("surg_policy_bridge", "model_server_node", "/policy", params)
        self.cycles: list[Seen] = []
        self.status = PolicyStatus()
        self.actions: list[PolicyAction] = []
        self.rejected: list[PolicyAction] = []
        self._lock = threading.Lock()
        self._ears = [
            rospy.Subscriber("/PSM1/cycle", Cycle, self._on_cycle, tcp_nodelay=True),
            rospy.Subscriber("/policy/status", PolicyStatus, self._on_status),
            rospy.Subscriber("/policy/action", PolicyAction, self.actions.append),
            rospy.Subscriber("/policy/rejected", PolicyAction, self.rejected.append),
        ]
        self.enable = rospy.Publisher("/policy/enable", Bool, queue_size=1)
        self.teleop = TeleopSpeaker()
        self.state_command = rospy.Publisher("/PSM1/state_command", StringStamped, queue_size=1)
        graph.wait_for(self._connected, 40.0, "the arm and the model server")

    def _simulator(self, graph: RosGraph) -> None:
        plan = SystemPlan(self.cell, ("PSM1",), False, (), graph.folder, record=False)
        for node in system.nodes(plan):
            system.start(graph.supervisor, node)  # as `./surg up` does

    def _connected(self) -> bool:
        mouths = (self.enable, self.teleop.publisher, self.state_command)
        heard = all(mouth.get_num_connections() for mouth in mouths)
        return heard and bool(self.cycles) and bool(self.status.state)

    def _on_cycle(self, cycle: Cycle) -> None:
        seen = Seen(
            at=time.monotonic(),
            tick=cycle.tick,
            p_set=np.array(cycle.p_set),
            p_tip=np.array(cycle.p_tip),
            rcm_error=cycle.rcm_error,
            state=cycle.state,
            source=cycle.source,
            period_us=cycle.period_us,
        )
        with self._lock:
            self.cycles.append(seen)

    def _on_status(self, message: PolicyStatus) -> None:
        self.status = message

    @property
    def state(self) -> str:
        """Of the server, such as RUNNING."""
        return value_name(self.status, "state")

    @property
    def reason(self) -> str:
        """Why it is not RUNNING, such as OPERATOR."""
        return value_name(self.status, "reason")

    # --- hands --------------------------------------------------------------------------------

    def policy(self, name: str, *words: str, script: Path = CIRCLE) -> Child:
        """Start a policy."""
        argv = [sys.executable, "-s", str(script), "--server", self.address, *words]
        return self.graph.supervisor.start(name, argv, essential=False)

    def wait_state(self, *states: str, timeout: float = 10.0) -> None:
        """Wait for a state of the server."""
        self.graph.wait_for(
            lambda: self.state in states,
            timeout,
            f"the policy to be {' or '.join(states)} (it is {self.status})",
        )

    def run(self) -> None:
        """Enable, and wait until the arm moves at 45 mm/s.

        A starved machine may have let go in between: the operator acts again.
        """
        asked = 0.0

        def moves() -> bool:
            nonlocal asked
            idle = self.state in ("READY", "PAUSED")
            if idle and time.monotonic() - asked > 0.7:
                asked = time.monotonic()
                self.enable.publish(True)
            return self.state == "RUNNING" and self.speed() > 0.045

        self.graph.wait_for(moves, 20.0, f"the arm to move ({self.status})")

    def say(self, word: str) -> None:
        """A state command by this process."""
        self.state_command.publish(StringStamped(string=word))

    # --- what the arm does --------------------------------------------------------------------

    @property
    def now(self) -> Seen:
        """The newest cycle."""
        return self.cycles[-1]

    def speed(self) -> float:
        """Of the set-point over the last 20 cycles, by their own count [m/s]."""
        with self._lock:
            last = self.cycles[-21:]
        if len(last) < 21:
            return 0.0
        return float(np.linalg.norm(last[-1].p_set - last[0].p_set)) / 0.04

    def standstill_after(self, moment: float, still: float = 0.15) -> float:
        """Wait until the set-point stands; how long after a moment it did [s]."""
        self.graph.wait_for(lambda: self._rest(still) is not None, 10.0, "standstill")
        at = self._rest(still)
        assert at is not None
        return at - moment

    def _rest(self, still: float) -> float | None:
        """When the set-point moved last, if that is long enough ago."""
        with self._lock:
            cycles = self.cycles[-1000:]
        for before, after in zip(cycles[-2::-1], cycles[:0:-1], strict=True):
            if np.linalg.norm(after.p_set - before.p_set) > 1e-6:
                return after.at if cycles[-1].at - after.at > still else None
        return cycles[0].at

    def largest_step(self, since: int = 0) -> float:
        """Of the set-point between two cycles, from the first in which it was ENABLED on [m]."""
        with self._lock:
            cycles = self.cycles[since:]
        first = next(i for i, seen in enumerate(cycles) if seen.state == Cycle.ENABLED)
        points = np.array([seen.p_set for seen in cycles[first:]])
        neighbours = np.diff([seen.tick for seen in cycles[first:]]) == 1
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1) * neighbours
        at = first + int(steps.argmax())
        around = [(c.tick, c.state, c.period_us, c.p_set) for c in cycles[at - 1 : at + 3]]
        print(f"the largest step is behind the second of these cycles: {around}")
        return float(steps.max())

    def close(self) -> None:
        """Leave the graph."""
        self.teleop.close()
        for end in (*self._ears, self.enable, self.state_command):
            end.unregister()


class Camera:
    """A camera that can freeze: noise at 20 Hz."""

    def __init__(self) -> None:
        self._out = rospy.Publisher("/test/left/image_raw", Image, queue_size=1)
        self._stop = threading.Event()
        self.fault = ""
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        rng = np.random.default_rng(1)
        pixels = rng.integers(0, 255, (24, 32, 3), np.uint8)
        while not self._stop.wait(1.0 / CAMERA_RATE):
            if self.fault == "silent":
                continue
            if self.fault != "frozen":
                pixels = rng.integers(0, 255, (24, 32, 3), np.uint8)
            image = Image(height=24, width=32, encoding="rgb8", step=96, data=pixels.tobytes())
            image.header.stamp = rospy.Time.from_sec(time.time())
            self._out.publish(image)

    def close(self) -> None:
        """Stop."""
        self._stop.set()
        self._thread.join()
        self._out.unregister()
