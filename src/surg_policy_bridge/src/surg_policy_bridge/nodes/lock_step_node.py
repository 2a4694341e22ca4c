"""The loop of the model server in lock-step: on the grid, time waits for the policy's answer."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable

import rosgraph
import rospy

from surg_core.arm_view import ArmView
from surg_core.contract import GRID, SECOND_NS, TICK_NS
from surg_policy_bridge.nodes.server_io_node import ServerIO
from surg_policy_bridge.server.model_server import ServerState
from surg_policy_bridge.server.observer import Observation
from surg_ros.participant import Participant, TickInputs
from surg_ros.peers import publishers

PATIENCE_NS = 8 * SECOND_NS
"""Longest wait for a picture; the simulator times out after 10 s."""
POLL_MS = 100


class LockStep:
    """Ages and due times are simulated, so a roll-out does not depend on computing time."""

    def __init__(self, io: ServerIO) -> None:
        self._io = io
        self._due: int | None = None
        self.force_inputs: dict[tuple[str, str], rospy.Subscriber] = {}
        """Subscribers of forces, by arm and place."""
        self.participant = Participant(
            io.ports,
            self._on_tick,
            io.settings.arms,
            task=bool(io.settings.task),
            grid=True,
            listen=False,  # the node needs the same messages
            lock=io.lock,
        )

    @property
    def forces(self) -> dict[str, list[str]]:
        """Places at which the simulator measures a force, by arm."""
        found: dict[str, list[str]] = {}
        for (arm, place), subscriber in self.force_inputs.items():
            if subscriber.get_num_connections():
                found.setdefault(arm, []).append(place)
        return found

    def begin(self) -> None:
        """Connect, once all subscribers are among the participant's inputs."""
        threading.Thread(target=self._connect, daemon=True).start()

    def now(self) -> int:
        """Time of the execution [ns]."""
        return self.participant.tick * TICK_NS

    def patience_ms(self) -> int:
        """Time until something is due."""
        return POLL_MS

    def turn(self) -> None:
        """Observe, wait for the answer, execute, answer the tick; with the lock held."""
        io = self._io
        if self._due is None:
            # No tick may ever come again, and a policy can be refused all the same.
            io.topics.publish_judged(io.server, self.now() + TICK_NS)
            return
        tick, self._due = self._due, None
        at, number = tick * TICK_NS, tick // GRID
        # In every state, so that the start of a policy does not depend on rendering time.
        self._await_values(at, io.sources.image_keys)
        self._wait_while(lambda: io.sources.forces_behind(at, self.forces), PATIENCE_NS)
        views = io.views()
        cause, obstacle = io.refusal()
        commands = io.server.tick(views, at, time.monotonic_ns(), obstacle, cause=cause)
        if io.server.state is ServerState.RUNNING:
            observation = self._complete(views, number)
            if observation is not None:
                io.server.observe(observation, at, time.monotonic_ns())
                io.reply()
            answer_ns = round(io.settings.answer_timeout * SECOND_NS)
            if not self._wait_while(lambda: io.server.unanswered, answer_ns):
                io.server.counters.waited += 1
            for arm, target in io.server.execute(number + 1, at).items():
                commands[arm] = target.commands()
        io.send(commands, views)
        io.topics.publish_judged(io.server, at + TICK_NS)
        io.reply()
        self.participant.ready()

    def _connect(self) -> None:
        """Answer tick 1, which has no cycle before it, once nothing can get lost."""
        while not self._io.over:
            try:
                over = lambda: self._io.over  # noqa: E731
                return self.participant.connect(math.inf, over, self._missing_forces)
            except TimeoutError:
                return None  # the node ends
            except OSError as error:
                rospy.logwarn_throttle(10, "policy: the ROS master does not answer: %s", error)
                time.sleep(0.5)
        return None

    def _missing_forces(self) -> str:
        """Which force is measured and does not reach this node yet; empty: none.

        A simulator that knows the tip's force registers it with the trocar's.
        """
        master, name = rosgraph.get_master_uri(), rospy.get_name()
        for subscriber in self.force_inputs.values():
            topic = subscriber.resolved_name
            if publishers(master, name, topic) and not subscriber.get_num_connections():
                return f"{topic} is not connected yet"
        return ""

    def _on_tick(self, seen: TickInputs) -> bool | None:
        """All cycles of a tick of the grid are here; `turn` answers it."""
        self._due = seen.tick
        self._io.rouse()
        return None

    def _complete(self, views: dict[str, ArmView], number: int) -> Observation | None:
        """The observation of a tick; waits for its parts."""
        io, wanted = self._io, self._io.server.wanted
        stamp_ns, problem = io.sources.add_arms(views)
        if stamp_ns is not None:
            self._await_values(stamp_ns, wanted)
            problem = io.sources.observer.missing(stamp_ns, wanted)
            if not problem:
                return io.sources.observer.take(number, stamp_ns, wanted)
        io.server.observe_nothing(problem)
        return None

    def _await_values(self, stamp_ns: int, keys: list[str] | tuple[str, ...]) -> None:
        """Wait for the values of one stamp."""
        self._wait_while(
            lambda: bool(self._io.sources.observer.missing(stamp_ns, keys)), PATIENCE_NS
        )

    def _wait_while(self, condition: Callable[[], bool], longest_ns: int) -> bool:
        """Answer messages while a condition holds; returns whether it ended in time."""
        deadline = time.monotonic_ns() + longest_ns
        while condition():
            if time.monotonic_ns() > deadline or self._io.finished.is_set():
                return False
            self._io.lock.release()  # callbacks need it
            try:
                self._io.wait(POLL_MS)
            finally:
                self._io.lock.acquire()
            self._io.listen()
        return True
