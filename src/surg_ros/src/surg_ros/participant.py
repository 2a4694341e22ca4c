"""What the nodes of scripted senders share: their part in lock-step.

A participant looks at tick k (control cycles of its arms; on the grid the task's state), sends
what it wants to send for tick k + 1, and says Ready with the running totals. In most ticks it has
nothing to say, so a message is kept as bytes until somebody looks into it: reading every cycle
would cost more than everything else that such a node does.
"""

from __future__ import annotations

import os
import random
import struct
import threading
import time
import xmlrpc.client
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import rospy

from surg_core.contract import GRID, SECOND_NS, TICK_NS
from surg_msgs.msg import Cycle, Ready, TaskState
from surg_ros.transport.direct_publisher import DirectPublisher
from surg_ros.transport.raw_message import RawCycle, RawTaskState

ASSISTANT = "assistant"
"""The name in Ready of what the simulator itself obeys."""
CONNECT_TIMEOUT = 60.0
"""[s] wall clock: longest wait for everybody to connect."""


def wait_for_all(
    missing: Callable[[], str], timeout: float, over: Callable[[], bool] = rospy.is_shutdown
) -> None:
    """Wait until nobody is missing.

    Args:
        missing: States who is missing; empty: nobody.
        timeout: [s]
        over: Whether there is nothing left to wait for.

    Raises:
        TimeoutError: Somebody is missing; states who.
    """
    deadline = time.monotonic() + timeout
    while text := missing():
        if time.monotonic() > deadline or over():
            raise TimeoutError(f"no connection after {timeout:.0f} s: {text}")
        time.sleep(0.02)


@dataclass(frozen=True)
class Seen:
    """What a participant sees of one tick; messages are read when they are asked for.

    Attributes:
        tick: The tick.
        cycles: Bytes of the control cycle by arm.
        task: Bytes of the task's state at this tick; empty off the grid.
    """

    tick: int
    cycles: Mapping[str, bytes]
    task: bytes

    @property
    def stamp(self) -> rospy.Time:
        """Of the tick that the answer is for."""
        return rospy.Time(*divmod((self.tick + 1) * TICK_NS, SECOND_NS))

    def cycle(self, arm: str) -> Cycle:
        """The control cycle of an arm."""
        return Cycle().deserialize(self.cycles[arm])

    def task_state(self) -> TaskState:
        """The task's state."""
        return TaskState().deserialize(self.task)


class ReadyLayout:
    """surg_msgs/Ready of one participant as bytes, packed from a prebuilt layout.

    Args:
        participant: Its name.
        arms: The arms that it commands.
    """

    def __init__(self, participant: str, arms: Sequence[str]) -> None:
        count = struct.pack("<I", len(arms))
        self._head = _text(participant) + count + b"".join(map(_text, arms)) + count
        self._tail = struct.Struct(f"<{len(arms)}QB")

    def pack(self, tick: int, sent: Iterable[int], done: bool) -> bytes:
        """The message as bytes; ``sent`` in the order of the arms."""
        return struct.pack("<Q", tick) + self._head + self._tail.pack(*sent, done)


def _text(words: str) -> bytes:
    data = words.encode()
    return struct.pack("<I", len(data)) + data


class Participant:
    """A declared sender.

    Args:
        arms: Whose cycles it looks at. One that looks at none has the task's state only: it acts on
            the grid, and says Ready from one grid tick to the next.
        commands: Message class by topic; a topic below ``/<arm>/`` counts for that arm.
        act: Called once per tick with what is seen; uses :meth:`send` and returns whether it is
            done.
        task: Whether it looks at the task's state too.
    """

    def __init__(
        self,
        arms: Sequence[str],
        commands: Mapping[str, type],
        act: Callable[[Seen], bool],
        task: bool,
    ) -> None:
        self._name = rospy.get_name().lstrip("/")
        self._act, self._task = act, task
        self._lock = threading.Lock()
        self._tick, self._done = 0, False
        self._cycles: dict[str, tuple[int, bytes]] = dict.fromkeys(arms, (0, b""))
        self._state: tuple[int, bytes] = (0, b"")
        self._sent = {topic.split("/")[1]: 0 for topic in commands}
        self._jitter = float(os.environ.get("SURG_TEST_JITTER_MS", "0")) / 1e3
        keys: dict[str, Any] = {"queue_size": 0, "tcp_nodelay": True}
        self._out = {
            topic: rospy.Publisher(topic, kind, **keys) for topic, kind in commands.items()
        }
        self._ready = DirectPublisher("/sim/ready", Ready, blocking=True, latch=True)
        self._layout = ReadyLayout(self._name, list(self._sent))
        listen: dict[str, Any] = {"queue_size": None, "tcp_nodelay": True}
        self._inputs = [
            rospy.Subscriber(f"/{arm}/cycle", RawCycle, self._on_cycle, arm, **listen)
            for arm in arms
        ]
        if task:
            self._inputs.append(
                rospy.Subscriber("/sim/task_state", RawTaskState, self._on_state, **listen)
            )

    def send(self, topic: str, message: Any) -> None:
        """Send a command and count it."""
        self._out[topic].publish(message)
        self._sent[topic.split("/")[1]] += 1

    def connect(self) -> None:
        """Wait for every connection, then speak for tick 1, which has no cycle before it.

        Raises:
            TimeoutError: Somebody is missing; says who.
        """
        deadline = time.monotonic() + CONNECT_TIMEOUT
        while missing := self._missing():
            if time.monotonic() > deadline or rospy.is_shutdown():
                raise TimeoutError(f"no connection after {CONNECT_TIMEOUT:.0f} s: {missing}")
            time.sleep(0.02)
        with self._lock:
            if self._tick == 0:
                self._say_ready(1 if self._cycles else GRID)

    def _missing(self) -> str:
        """Who is not there yet; nothing may be sent before, for it would be lost."""
        for subscriber in self._inputs:
            if subscriber.get_num_connections() == 0:
                return f"nobody publishes {subscriber.resolved_name}"
        controllers = {f"/{arm}/controller" for arm in self._cycles}
        wanted = {topic: {_receiver(topic)} for topic in self._out}
        wanted["/sim/ready"] = {"/sim", *controllers}
        with xmlrpc.client.ServerProxy(rospy.get_node_uri()) as node:
            links: Any = node.getBusInfo(rospy.get_name())
        there = {(topic, peer) for _, peer, way, _, topic, on, *_ in links[2] if way == "o" and on}
        for topic, nodes in wanted.items():
            away = sorted(node for node in nodes if (topic, node) not in there)
            if away:
                return f"{topic} does not reach {', '.join(away)}"
        return ""

    def _on_cycle(self, message: RawCycle, arm: str) -> None:
        with self._lock:
            tick = message.tick()
            if tick > self._cycles[arm][0]:
                self._cycles[arm] = (tick, message.data)
                self._advance()

    def _on_state(self, message: RawTaskState) -> None:
        with self._lock:
            tick = message.tick()
            # One off the grid ends the episode. It may overtake a cycle: a controller's answer can
            # lead to it before that controller's cycle has come. Nobody here acts on it.
            if tick > self._state[0] and tick % GRID == 0:
                self._state = (tick, message.data)
                self._advance()

    def _advance(self) -> None:
        """Answer the present tick when all of it is here; with the lock held."""
        ticks = {tick for tick, _ in self._cycles.values()} or {self._state[0]}
        tick = max(ticks)
        if self._done or tick <= self._tick or len(ticks) > 1:
            return
        on_grid = self._task and tick % GRID == 0
        if on_grid and self._state[0] != tick:
            return  # its state is still to come
        self._tick = tick
        if self._jitter:
            time.sleep(random.uniform(0.0, self._jitter))
        cycles = {arm: data for arm, (_, data) in self._cycles.items()}
        self._done = self._act(Seen(tick, cycles, self._state[1] if on_grid else b""))
        self._say_ready(tick + 1 if self._cycles else tick + GRID)

    def _say_ready(self, tick: int) -> None:
        self._ready.send(self._layout.pack(tick, self._sent.values(), self._done))


def _receiver(topic: str) -> str:
    """The node that must hear a command topic."""
    first = topic.split("/")[1]
    return "/sim" if first == ASSISTANT else f"/{first}/controller"
