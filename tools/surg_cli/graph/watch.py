"""Listens to a running system: the simulator's status, the arms' states, their complaints."""

from __future__ import annotations

import json
import threading
import time
from collections import deque
from collections.abc import Sequence
from typing import Any

from surg_cli.host.terminal import warn


class Watch:
    """What a running system says of itself, kept up to date by rospy's threads.

    A context manager: leave it before the master ends.

    ROS is imported on construction: the environment must be sourced and a master must answer.
    """

    KEPT = 50

    def __init__(
        self, arms: Sequence[str], name: str = "surg", senders: Sequence[str] = ()
    ) -> None:
        """Become a ROS node and subscribe.

        Args:
            arms: CRTK names of the arms.
            name: Name of the node; a number is added.
            senders: Names of scripted nodes whose reasons are wanted.
        """
        import rospy
        from std_msgs.msg import Bool, String

        from crtk_msgs.msg import OperatingState

        rospy.init_node(name, anonymous=True, disable_signals=True)
        self._lock = threading.Lock()
        self._sim: dict[str, Any] = {}
        self._sim_changed = time.monotonic()
        self._recording: bool | None = None
        self._record: dict[str, Any] = {}
        self._states: dict[str, str] = {}
        self._faulted: list[str] = []
        self._errors: dict[str, str] = {}
        self._gave_up: dict[str, str] = {}
        self._policy: dict[str, Any] = {}
        self._news: deque[tuple[str, str]] = deque(maxlen=self.KEPT)
        self._bool = Bool
        self._record_switch = rospy.Publisher("/record/record", Bool, queue_size=1, latch=True)
        subscribe = rospy.Subscriber
        self._subscribers = [
            subscribe("/sim/status", String, self._on_sim),
            subscribe("/record/recording", Bool, self._on_recording),
            subscribe("/record/status", String, self._on_record),
            subscribe("/policy/status", String, self._on_policy),
        ]
        for sender in senders:
            self._subscribers.append(
                subscribe(f"/{sender}/status", String, self._on_sender, sender)
            )
        for arm in arms:
            topic = f"/{arm}/operating_state"
            self._subscribers.append(subscribe(topic, OperatingState, self._on_state, arm))
            for kind in ("error", "warning"):
                topic = f"/{arm}/{kind}"
                self._subscribers.append(subscribe(topic, String, self._on_text, (arm, kind)))

    def __enter__(self) -> Watch:
        """Return itself."""
        return self

    def __exit__(self, kind: object, value: object, trace: object) -> None:
        """Leave the graph while its master still answers: without one, leaving takes seconds."""
        import rospy

        rospy.signal_shutdown("surg is done")

    def begin(self) -> None:
        """The simulator is started now: from here on it may be missed."""
        with self._lock:
            self._sim_changed = time.monotonic()

    def record(self, on: bool) -> None:
        """Tell the recorder to start or to stop; latched, so a late recorder hears it too."""
        self._record_switch.publish(self._bool(on))

    @property
    def sim(self) -> dict[str, Any]:
        """The newest `/sim/status`, empty before the first."""
        with self._lock:
            return dict(self._sim)

    @property
    def stalled_s(self) -> float:
        """Time since the simulator's tick last changed."""
        with self._lock:
            return time.monotonic() - self._sim_changed

    @property
    def recording(self) -> bool | None:
        """Whether the recorder says it records; None before it has said anything."""
        with self._lock:
            return self._recording

    @property
    def record_status(self) -> dict[str, Any]:
        """The newest `/record/status`, empty before the first."""
        with self._lock:
            return dict(self._record)

    @property
    def policy(self) -> dict[str, Any]:
        """The newest `/policy/status`, empty before the first."""
        with self._lock:
            return dict(self._policy)

    @property
    def states(self) -> dict[str, str]:
        """Arm -> its newest operating state."""
        with self._lock:
            return dict(self._states)

    @property
    def faulted(self) -> list[str]:
        """Arms that have been in FAULT, in the order it happened."""
        with self._lock:
            return list(self._faulted)

    @property
    def gave_up(self) -> dict[str, str]:
        """Scripted sender -> why it gave up."""
        with self._lock:
            return dict(self._gave_up)

    def news(self) -> list[tuple[str, str]]:
        """(arm and kind, text) of the errors and warnings since the last call, oldest first.

        No more than the newest `KEPT`: a flood is not worth reading.
        """
        with self._lock:
            fresh = list(self._news)
            self._news.clear()
        return fresh

    def last_error(self, arm: str) -> str:
        """The newest error of an arm, empty when it has none."""
        with self._lock:
            return self._errors.get(arm, "")

    def _on_sim(self, message: Any) -> None:
        status = _parse(message.data, "/sim/status")
        with self._lock:
            if status.get("tick") != self._sim.get("tick"):
                self._sim_changed = time.monotonic()
            self._sim = status

    def _on_recording(self, message: Any) -> None:
        with self._lock:
            self._recording = bool(message.data)

    def _on_record(self, message: Any) -> None:
        status = _parse(message.data, "/record/status")
        with self._lock:
            self._record = status

    def _on_policy(self, message: Any) -> None:
        status = _parse(message.data, "/policy/status")
        with self._lock:
            self._policy = status

    def _on_sender(self, message: Any, sender: str) -> None:
        reason = _parse(message.data, f"/{sender}/status").get("reason")
        if reason:
            with self._lock:
                self._gave_up[sender] = str(reason)

    def _on_state(self, message: Any, arm: str) -> None:
        with self._lock:
            before = self._states.get(arm)
            self._states[arm] = message.state
            if message.state == "FAULT" and before != "FAULT":
                self._faulted.append(arm)

    def _on_text(self, message: Any, origin: tuple[str, str]) -> None:
        with self._lock:
            self._news.append((" ".join(origin), message.data))
            if origin[1] == "error":
                self._errors[origin[0]] = message.data


def _parse(text: str, topic: str) -> dict[str, Any]:
    """Read a JSON object; anything else is said and taken as empty."""
    try:
        value = json.loads(text)
    except ValueError:
        value = None
    if not isinstance(value, dict):
        warn(f"surg: {topic} does not hold a JSON object: {text[:80]!r}")
        return {}
    return value
