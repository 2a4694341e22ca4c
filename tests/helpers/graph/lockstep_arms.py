"""Simulated time that several arms' clients share: it passes only while one of them waits."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence

import rospy

from helpers.graph.crtk_client import TICK
from surg_msgs.msg import Cycle, Ready
from surg_ros.byte_topics import listeners


class Ticks:
    """The declared participant that steps the graph.

    Args:
        participant: The name under which controllers and simulator wait for this node.
        arms: Those that it commands.
    """

    def __init__(self, participant: str, arms: Sequence[str]) -> None:
        self.changed = threading.Condition()
        self.tick = 0
        self.sent = dict.fromkeys(arms, 0)
        self._name, self._done = participant.lstrip("/"), dict.fromkeys(arms, 0)
        self._ready = rospy.Publisher("/sim/ready", Ready, queue_size=0, tcp_nodelay=True)
        self._ears = [
            rospy.Subscriber(
                f"/{arm}/cycle", Cycle, self._on_cycle, arm, queue_size=None, tcp_nodelay=True
            )
            for arm in arms
        ]

    def connected(self) -> bool:
        """Whether simulator and controllers hear it, and it hears the controllers."""
        heard = all(ear.get_num_connections() for ear in self._ears)
        return heard and len(listeners(self._ready)) >= 1 + len(self._ears)

    def _on_cycle(self, message: Cycle, arm: str) -> None:
        with self.changed:
            self._done[arm] = message.tick
            self.changed.notify_all()

    def step(self) -> None:
        """One tick."""
        self.tick += 1
        arms, sent = list(self.sent), list(self.sent.values())
        self._ready.publish(Ready(tick=self.tick, participant=self._name, arms=arms, sent=sent))
        give_up = time.monotonic() + 60.0
        with self.changed:
            while not self.changed.wait_for(lambda: min(self._done.values()) >= self.tick, 0.2):
                assert time.monotonic() < give_up, f"tick {self.tick}: cycles at {self._done}"

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        for _ in range(round(seconds / TICK)):
            self.step()

    def close(self) -> None:
        """Leave the graph."""
        for topic in (self._ready, *self._ears):
            topic.unregister()


class ArmTime:
    """The clock of one arm's client; see ``crtk_client.Time``."""

    def __init__(self, ticks: Ticks, arm: str) -> None:
        self.changed, self._ticks, self._arm = ticks.changed, ticks, arm

    def now(self) -> float:
        """Stamp of the last cycle [s]."""
        return self._ticks.tick * TICK

    def until(self, met: Callable[[], bool], timeout: float) -> bool:
        """Step while the condition does not hold."""
        for _ in range(round(timeout / TICK)):
            if met():
                return True
            self._ticks.step()
        return met()

    def count(self) -> None:
        """The controller waits for what has been announced."""
        self._ticks.sent[self._arm] += 1
