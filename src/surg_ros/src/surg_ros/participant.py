"""A declared sender in lock-step: it sees tick k, sends commands for tick k + 1, then says Ready.

Ready carries the running totals of the commands sent, so that simulator and controllers know what
is still on its way.
"""

from __future__ import annotations

import io
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import rosgraph
import rospy

from surg_core.arm_view import ArmView, Array
from surg_core.contract import GRID, TICK_NS
from surg_msgs.msg import Cycle, Ready, TaskState
from surg_ros.arm_port import ArmPort, arm_view
from surg_ros.byte_topics import BytesPublisher, on_grid
from surg_ros.peers import publishers, subscribers

ASSISTANT = "assistant"
"""Name of the instrument that the simulator itself drives; it has no controller."""
CONNECT_TIMEOUT = 60.0
"""[s] wall clock: longest wait for all connections."""


def wait_for_all(
    missing: Callable[[], str], timeout: float, over: Callable[[], bool] = rospy.is_shutdown
) -> None:
    """Wait until nobody is missing, or there is nothing left to wait for; ``timeout`` in [s].

    Raises:
        TimeoutError: Somebody is missing; states who.
    """
    deadline = time.monotonic() + timeout
    while text := missing():
        if time.monotonic() > deadline or over():
            raise TimeoutError(f"no connection after {timeout:.0f} s: {text}")
        time.sleep(0.02)


@dataclass(frozen=True)
class TickInputs:
    """What a participant sees of one tick."""

    tick: int
    cycles: Mapping[str, Cycle]  # control cycle by arm
    task: TaskState | None  # the task's state at this tick; None off the grid, or not asked for

    @property
    def stamp_ns(self) -> int:
        """Stamp of the tick that the answer is for [ns]."""
        return (self.tick + 1) * TICK_NS

    def view(self, arm: str, R_WB: Array | None = None) -> ArmView:
        """What an arm reports; arguments as of `arm_view`."""
        return arm_view(self.cycles[arm], R_WB)


class Participant:
    """A node that sends commands to arms, one answer per tick.

    Args:
        ports: The ports of the arms that it commands, by name.
        act: Called once per tick, with the lock held. Returns True: done, nothing more will be
            sent; False: not done; None: the answer follows by :meth:`ready`.
        arms: Arms whose cycles it needs; with none it needs the task's state only.
        task: Whether it needs the task's state on the grid too.
        grid: Whether it acts on the grid only, and says Ready from one grid tick to the next; so
            does one without arms.
        lockstep: False: no Ready; ``act`` is called for every cycle of the first arm, after
            :meth:`connect` and once all arms have been heard.
        listen: False: the node subscribes itself, and calls :meth:`on_cycle` and :meth:`on_task`.
        lock: Of the node; default: its own.
    """

    def __init__(
        self,
        ports: Mapping[str, ArmPort],
        act: Callable[[TickInputs], bool | None],
        arms: Sequence[str],
        task: bool = False,
        grid: bool = False,
        lockstep: bool = True,
        listen: bool = True,
        lock: Any = None,
    ) -> None:
        self._ports, self._act, self._arms = dict(ports), act, tuple(arms)
        self._task, self._lockstep = task, lockstep
        self._period = GRID if grid or not arms else 1  # [ticks] from one answer to the next
        self._lock = lock or threading.RLock()
        self._done = False
        # In lock-step no tick follows before this node's first Ready.
        self._connected = lockstep
        self.tick = 0
        """The tick that was seen last."""
        self._cycles: dict[str, tuple[int, Cycle]] = {}
        self._state: tuple[int, TaskState] = (0, TaskState())
        self._on_grid = threading.Condition()  # a state of the task has come
        if lockstep:
            self._ready = BytesPublisher("/sim/ready", Ready, blocking=True, latch=True)
        self.inputs: list[Any] = []
        """Subscribers that must be connected before the first tick."""
        if listen:
            keys: dict[str, Any] = {"queue_size": None, "tcp_nodelay": True}
            kind = on_grid(Cycle) if grid else Cycle
            self.inputs += [
                rospy.Subscriber(f"/{arm}/cycle", kind, self.on_cycle, arm, **keys) for arm in arms
            ]
            if task:
                self.inputs.append(
                    rospy.Subscriber("/sim/task_state", TaskState, self.on_task, **keys)
                )

    @property
    def silent(self) -> list[str]:
        """Arms that have not been heard yet."""
        return sorted(set(self._arms) - set(self._cycles))

    def connect(
        self,
        timeout: float = CONNECT_TIMEOUT,
        over: Callable[[], bool] = rospy.is_shutdown,
        also: Callable[[], str] = str,
    ) -> None:
        """Wait for every connection, then answer tick 1, which has no cycle before it.

        ``also`` states what else is missing; empty: nothing.

        Raises:
            TimeoutError: Somebody is missing after ``timeout`` [s]; states who.
            OSError: The master does not answer.
        """
        wait_for_all(lambda: self._missing() or also(), timeout, over)
        with self._lock:
            self._connected = True
            if self._lockstep and self.tick == 0:
                self._say_ready(self._period)

    def _missing(self) -> str:
        """Who is not connected yet; what is sent before would be lost."""
        master, name = rosgraph.get_master_uri(), rospy.get_name()
        wanted: dict[str, set[str]] = {"/sim/ready": set()} if self._lockstep else {}
        for arm, port in self._ports.items():
            source = f"/{arm}/measured_js" if arm == ASSISTANT else f"/{arm}/cycle"
            receivers = publishers(master, name, source)
            if not receivers:
                return f"nobody publishes {source} (is the controller running?)"
            wanted.update({f"/{arm}/{topic}": receivers for topic in port.out})
            if self._lockstep:
                links = publishers(master, name, f"/{arm}/robot/measured_js")
                if not links and arm != ASSISTANT:
                    return f"nobody publishes /{arm}/robot/measured_js (is the simulator running?)"
                wanted["/sim/ready"] |= receivers | links
        for subscriber in self.inputs:
            if subscriber.get_num_connections() == 0:
                return f"{subscriber.resolved_name} is not connected yet"
        present = subscribers(rospy.get_node_uri(), name, wanted)
        for topic, nodes in wanted.items():
            if away := sorted(nodes - present[topic]):
                return f"{topic} does not reach {', '.join(away)}"
        return ""

    def on_cycle(self, message: Cycle, arm: str) -> None:
        """A control cycle has come."""
        tick = message.tick
        if tick % self._period:
            self._gather(tick)
            return
        with self._lock:
            if tick > self._cycles.get(arm, (0, None))[0]:
                self._cycles[arm] = (tick, message)
                if self._lockstep or arm == self._arms[0]:
                    self._advance()

    def _gather(self, tick: int) -> None:
        """Leave cycles in their socket up to the next tick of the grid: its state comes before."""
        with self._on_grid:
            while self._task and self._state[0] < tick and not rospy.is_shutdown():
                self._on_grid.wait(1.0)

    def on_task(self, message: TaskState) -> None:
        """A state of the task has come."""
        with self._lock:
            tick = message.tick
            # One off the grid ends the episode. It may overtake a cycle: a controller's answer can
            # lead to it before that controller's cycle has come. No participant acts on it.
            if tick > self._state[0] and tick % GRID == 0:
                with self._on_grid:
                    self._state = (tick, message)
                    self._on_grid.notify_all()
                self._advance()

    def _advance(self) -> None:
        """Answer the present tick once all of it is here; with the lock held."""
        ticks = [self._cycles[arm][0] for arm in self._arms if arm in self._cycles]
        tick = ticks[0] if ticks else self._state[0]
        complete = len(ticks) == len(self._arms)
        if self._lockstep:
            complete = complete and len(set(ticks)) <= 1
        on_grid = self._task and tick % GRID == 0
        if on_grid and self._state[0] != tick:
            return  # its state is still to come
        if not complete or tick <= self.tick or not self._connected:
            return  # a command that is sent before the connection is lost
        self.tick = tick
        if self._done:  # the others' ticks still wait for this Ready
            self.ready(True)
            return
        cycles = {arm: cycle for arm, (_, cycle) in self._cycles.items()}
        done = self._act(TickInputs(tick, cycles, self._state[1] if on_grid else None))
        if done is not None:
            self.ready(done)

    def ready(self, done: bool = False) -> None:
        """All commands of the present tick are sent; with the lock held."""
        self._done = done
        if self._lockstep:
            self._say_ready(self.tick + self._period)

    def _say_ready(self, tick: int) -> None:
        message = Ready(
            tick=tick,
            participant=rospy.get_name().lstrip("/"),
            arms=list(self._ports),
            sent=[port.sent for port in self._ports.values()],
            done=self._done,
        )
        packed = io.BytesIO()
        message.serialize(packed)
        self._ready.send(packed.getvalue())
