"""The robot's side of the console: collects the state of the system from topics.

Messages of fast topics wait as bytes and are decoded only when the page needs a value.
"""

from __future__ import annotations

import json
import math
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import rospy
from geometry_msgs.msg import WrenchStamped
from std_msgs.msg import String

from crtk_msgs.msg import OperatingState
from surg_console.labelling import label_file
from surg_console.ros.order_topics_node import OrderTopics
from surg_console.ros.overlay_topics_node import OverlayTopics
from surg_console.ros.status_values_node import (
    REASONS,
    calibration_of,
    drift_of,
    fixture_of,
    follower_of,
    force_of,
    lengths_of,
    policy_of,
    recorder_of,
    task_of,
)
from surg_console.session import operator_messages
from surg_console.session.console_orders import Order
from surg_console.session.episode_list import Entry, Episodes
from surg_console.session.fixture_view import FixtureView
from surg_console.session.page_status import finite
from surg_console.session.system_state import (
    Arm,
    Follower,
    Gauges,
    PolicyServer,
    Robot,
    SimTask,
)
from surg_console.session.tip_force_feedback import tip_force_feedback
from surg_core import Fixture
from surg_core.config import Cell
from surg_core.contract import STATE_NAMES
from surg_core.status_check import LatestStatus
from surg_core.transforms import quaternion_xyzw_to_matrix
from surg_msgs.msg import (
    CalibrationStatus,
    Cycle,
    DriftStatus,
    Fixtures,
    PolicyStatus,
    RecordStatus,
    ScalarStamped,
    SimStatus,
    TeleopStatus,
)
from surg_recording.recording_errors import EpisodeError
from surg_ros.byte_topics import BytesSubscriber

JUDGE = "console"
"""Who has judged, in the labels: the page does not know the person's name."""
STATES = dict(enumerate(STATE_NAMES))
FRESH = 1.0
"""[s] Timeout of a live value."""
STATUSES = {
    "/record/status": RecordStatus,
    "/sim/status": SimStatus,
    "/policy/status": PolicyStatus,
    "/calibrate/status": CalibrationStatus,
    "/endoscope/drift": DriftStatus,
}
FAST = {
    "trocar": ("trocar/measured_cf", WrenchStamped),
    "tip": ("tool/measured_cf", WrenchStamped),
    "clearance": ("clearance", ScalarStamped),
}
"""Topics of the driven arm with live values that its cycle has not."""
PAUSE = 0.01
"""[s] The cycles of a tick of the session are taken together: 500 a second wake nobody each."""


class RosSystem:
    """See `RunningSystem`; the driven arm comes first, an empty leader means no leader."""

    def __init__(
        self,
        cell: Cell,
        arms: tuple[str, ...],
        leader: str,
        teleop: str,
        episodes: Path | None,
    ) -> None:
        self._overlays = OverlayTopics(cell)
        self._lock = threading.Lock()
        self._arms = {name: Arm(name) for name in arms}
        self._teleop = f"/{teleop}/status"
        kinds = STATUSES | {self._teleop: TeleopStatus}
        self._statuses = {topic: LatestStatus(topic) for topic in kinds}
        self._newest: dict[str, tuple[float, Any]] = {}
        self._peak = 0.0
        self._episodes = None if episodes is None else Episodes(episodes)
        self._orders = OrderTopics(arms, leader)
        self._fast = {
            what: BytesSubscriber(f"/{arms[0]}/{topic}", kind)
            for what, (topic, kind) in FAST.items()
        }
        self._cycles = {arm: BytesSubscriber(f"/{arm}/cycle", Cycle, PAUSE) for arm in arms}
        keys: dict[str, Any] = {"queue_size": 10, "tcp_nodelay": True}
        self._driven = arms[0]
        self._regions: tuple[Fixture, ...] = ()
        rospy.Subscriber(f"/{arms[0]}/fixtures", Fixtures, self._on_fixtures, **keys)
        for topic, kind in kinds.items():
            rospy.Subscriber(topic, kind, self._on_status, topic, **keys)
        for arm in arms:
            rospy.Subscriber(f"/{arm}/operating_state", OperatingState, self._on_state, arm, **keys)
            rospy.Subscriber(f"/{arm}/warning", String, self._on_warning, arm, **keys)

    def close(self) -> None:
        """Stop polling, so that plain subscribers of this process hear the arms."""
        for polled in (*self._fast.values(), *self._cycles.values()):
            polled.unregister()

    def _hear_fast(self, now: float) -> None:
        """Fetch the fast topics; with the lock held."""
        for what, polled in self._fast.items():
            messages = polled.fetch()
            if messages:
                self._newest[what] = (now, FAST[what][1]().deserialize(messages[-1]))

    def _on_state(self, message: OperatingState, arm: str) -> None:
        with self._lock:
            before = self._arms[arm]
            self._arms[arm] = replace(
                before,
                state=message.state,
                homed=message.is_homed,
                heard=time.monotonic(),
                reason=before.reason if message.state == before.state else None,
            )

    def _on_fixtures(self, message: Fixtures) -> None:
        regions = tuple(map(fixture_of, message.fixtures))
        with self._lock:
            self._regions = regions

    def _fixtures(self) -> FixtureView | None:
        """The driven arm's fixtures beside its newest pose; with the lock held."""
        _, cycle = self._newest.get("cycle", (0.0, None))
        if not self._regions or cycle is None:
            return None
        X_BR = np.eye(4)
        X_BR[:3, :3] = quaternion_xyzw_to_matrix(cycle.q_br)
        X_BR[:3, 3] = cycle.p_rcm
        return FixtureView(self._regions, np.array(cycle.p_tip), X_BR)

    def _on_warning(self, message: String, arm: str) -> None:
        with self._lock:
            self._arms[arm] = replace(
                self._arms[arm],
                warning=operator_messages.without_name(message.data, arm),
                warned=time.monotonic(),
            )

    def _on_status(self, message: Any, topic: str) -> None:
        with self._lock:
            now = time.monotonic()
            self._statuses[topic].take(message, now)
            if complaint := self._statuses[topic].complaint(now):
                rospy.logwarn("console: %s", complaint)

    def _hear_cycles(self, now: float) -> None:
        """Store the reason of each arm's state, and how the driven one is; with the lock held."""
        for name, polled in self._cycles.items():
            messages = polled.fetch()
            if not messages:
                continue
            newest = Cycle().deserialize(messages[-1])
            if name == self._driven:
                self._newest["cycle"] = (now, newest)
                errors = (Cycle().deserialize(data).rcm_error for data in messages)
                self._peak = max(self._peak, *errors)
            if STATES.get(newest.state) == self._arms[name].state:
                reason = REASONS.get(newest.reason_code)
                self._arms[name] = replace(self._arms[name], reason=reason)

    def robot(self) -> Robot:
        """See `RunningSystem`."""
        now = time.monotonic()
        with self._lock:
            self._hear_fast(now)
            self._hear_cycles(now)
            hands = self._hands(now)
            first, others = hands[0], hands[1:]
            own = [hand for hand in others if hand.leader == first.leader]
            recorder, *acted_on = (self._statuses[topic] for topic in STATUSES)
            sim, policy, calibration, drift = (status.at(now) for status in acted_on)
            return Robot(
                tuple(self._arms.values()),
                first,
                own[0] if own else Follower(),
                tuple(hand for hand in others if hand.leader != first.leader),
                self._gauges(now),
                fixtures=self._fixtures(),
                recorder=recorder_of(recorder, now),
                simulated=sim is not None,
                task=task_of(sim) if sim else SimTask(),
                policy=policy_of(policy) if policy else PolicyServer(),
                calibration=calibration_of(calibration) if calibration else None,
                drift=drift_of(drift) if drift else None,
            )

    def _gauges(self, now: float) -> Gauges:
        """Live values of the driven arm; with the lock held."""
        newest = {what: said for what, (heard, said) in self._newest.items() if now - heard < FRESH}
        found = Gauges()
        if "cycle" in newest:
            found = replace(lengths_of(newest["cycle"]), rcm_peak=self._peak)
        return replace(
            found,
            trocar=force_of(newest.get("trocar")),
            tip=force_of(newest.get("tip")),
            clearance=newest["clearance"].value if "clearance" in newest else None,
        )

    def _hands(self, now: float) -> list[Follower]:
        """State of every leader from the teleoperation; one empty value: unknown."""
        status = self._statuses[self._teleop].at(now)
        if status is None or not status.hands:
            return [Follower()]
        first, *others = map(follower_of, status.hands)
        return [replace(first, reason=first.reason or status.picture), *others]

    def reset_peaks(self) -> None:
        """See `RunningSystem`."""
        with self._lock:
            self._peak = 0.0

    def entries(self) -> list[Entry]:
        """See `RunningSystem`."""
        return [] if self._episodes is None else self._episodes.entries()

    def judge(self, word: str) -> str:
        """See `RunningSystem`."""
        folder = Path(self.robot().recorder.finished)
        if self._episodes is None or not self._episodes.has(folder):
            return operator_messages.not_here(folder)
        try:
            if word == "discard":
                label_file.discard(folder)
            else:
                label_file.judge(folder, word == "success", JUDGE)
        except EpisodeError as error:
            return f"Not judged: {error}"
        return ""

    def publish_orders(self, orders: list[Order]) -> None:
        """See `RunningSystem`."""
        for order in orders:
            self._orders.send(order)

    def watch(self, what: str, wanted: bool) -> None:
        """See `RunningSystem`."""
        if what != "feel":  # its topic is heard anyway
            self._overlays.watch(what, wanted)

    def overlay(self, what: str) -> str:
        """See `RunningSystem`."""
        return self._feel() if what == "feel" else self._overlays.overlay(what)

    def _feel(self) -> str:
        now = time.monotonic()
        with self._lock:
            self._hear_fast(now)
            heard, wrench = self._newest.get("tip", (-math.inf, None))
            following = self._hands(now)[0].state == "FOLLOWING"
        felt = tip_force_feedback(finite(force_of(wrench)), heard, now, following)
        return json.dumps({**felt, "age": finite(felt["age"])}, allow_nan=False)

    def keep_alive(self) -> None:
        """See `RunningSystem`."""
        self._orders.repeat()
