"""Listens to a running system: the simulator's status, the arms' states, their complaints."""

from __future__ import annotations

import signal
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, Self

from surg_cli.host.terminal import warn

PAUSE_SIGNAL = signal.SIGUSR1
"""Makes a supervising process pause every arm of its system (`./surg stop`)."""
CONNECT_S = 1.0
"""[s] The arms' controllers connect to a new sender in this time."""
FAULT_GRACE_S = 1.0
"""[s] An arm in FAULT gets this time to send its error."""


def state_command(arm: str, latch: bool) -> Any:
    """A new publisher of an arm's state commands."""
    import rospy

    from crtk_msgs.msg import StringStamped

    keys = {"queue_size": 10, "latch": latch, "tcp_nodelay": True}
    return rospy.Publisher(f"/{arm}/state_command", StringStamped, **keys)


def pause_arms(arms: Sequence[str], ready: Mapping[str, Any] | None = None) -> None:
    """Tell arms to pause.

    Args:
        arms: Their names.
        ready: Publishers that are connected already, by arm: the fastest way. All arms are told
            by new ones as well; a connection may be broken.
    """
    from crtk_msgs.msg import StringStamped

    pause = StringStamped(string="pause")
    for arm in arms:
        if ready and arm in ready:
            ready[arm].publish(pause)
    told = [state_command(arm, latch=True) for arm in arms]
    for publisher in told:
        publisher.publish(pause)
    time.sleep(CONNECT_S)  # latched: whoever connects in this time is told
    for publisher in told:
        publisher.unregister()


class Watch:
    """What a running system reports, kept up to date by rospy's threads.

    A context manager: leave it before the master ends. ROS is imported on construction: the
    environment must be sourced and a master must answer. ``senders`` are the scripted nodes whose
    reasons are wanted.
    """

    KEPT = 50

    def __init__(
        self, arms: Sequence[str], name: str = "surg", senders: Sequence[str] = ()
    ) -> None:
        import rospy
        from std_msgs.msg import Bool, String

        from crtk_msgs.msg import OperatingState
        from surg_core.status_check import LatestStatus
        from surg_msgs.msg import PolicyStatus, RecordStatus, SenderStatus, SimStatus

        rospy.init_node(name, anonymous=True, disable_signals=True)
        self._lock = threading.Lock()
        self._kinds = {
            "/sim/status": SimStatus,
            "/record/status": RecordStatus,
            "/policy/status": PolicyStatus,
            **{f"/{sender}/status": SenderStatus for sender in senders},
        }
        self._statuses = {topic: LatestStatus(topic) for topic in self._kinds}
        self._sim_changed = time.monotonic()
        self.recording: bool | None = None
        """Whether the recorder says it records; None before it has said anything."""
        self._states: dict[str, str] = {}
        self._fault: tuple[str, float] | None = None
        """The first arm in FAULT, and since when on the steady clock [s]."""
        self._errors: dict[str, str] = {}
        self._gave_up: dict[str, str] = {}
        self._news: deque[tuple[str, str]] = deque(maxlen=self.KEPT)
        self._bool = Bool
        self._record_switch = rospy.Publisher("/record/record", Bool, queue_size=1, latch=True)
        self._record_info = rospy.Publisher("/record/info", String, queue_size=1, latch=True)
        subscribe = rospy.Subscriber
        self._subscribers = [subscribe("/record/recording", Bool, self._on_recording)]
        for topic, kind in self._kinds.items():
            self._subscribers.append(subscribe(topic, kind, self._on_status, topic))
        self._arms = tuple(arms)
        self._ready: dict[str, Any] = {}
        if arms and threading.current_thread() is threading.main_thread():
            signal.signal(PAUSE_SIGNAL, lambda *_: self._begin_pause())
        for arm in arms:
            topic = f"/{arm}/operating_state"
            self._subscribers.append(subscribe(topic, OperatingState, self._on_state, arm))
            for kind in ("error", "warning"):
                topic = f"/{arm}/{kind}"
                self._subscribers.append(subscribe(topic, String, self._on_text, (arm, kind)))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, value: object, trace: object) -> None:
        """Leave the graph while its master still answers: without one, leaving takes seconds."""
        import rospy

        if threading.current_thread() is threading.main_thread():
            signal.signal(PAUSE_SIGNAL, signal.SIG_IGN)
        rospy.signal_shutdown("surg is done")

    def begin(self) -> None:
        """The simulator is started now: from here on it may be missed."""
        with self._lock:
            self._sim_changed = time.monotonic()

    def record(self, on: bool) -> None:
        """Tell the recorder to start or to stop; latched, so a late recorder hears it too."""
        self._record_switch.publish(self._bool(on))

    def tell_recorder(self, facts: str) -> None:
        """Facts about the run as JSON, for the manifest."""
        self._record_info.publish(facts)

    def stay_connected(self) -> None:
        """Keep connections on which arms are told to pause, so that a pause needs no new one.

        Not in lock-step: there only declared senders may publish.
        """
        self._ready = {arm: state_command(arm, latch=False) for arm in self._arms}

    def _begin_pause(self) -> None:
        told = (self._enabled(), self._ready)
        threading.Thread(target=pause_arms, args=told, daemon=True).start()

    def _enabled(self) -> list[str]:
        """Arms that are ENABLED, or whose state is not known."""
        with self._lock:
            return [arm for arm in self._arms if self._states.get(arm, "ENABLED") == "ENABLED"]

    @property
    def sim(self) -> Any:
        """The newest valid `surg_msgs/SimStatus`; all fields default before the first."""
        return self._valid("/sim/status")

    @property
    def stalled_s(self) -> float:
        """Time since the simulator's tick last changed."""
        with self._lock:
            return time.monotonic() - self._sim_changed

    @property
    def record_status(self) -> Any:
        """The newest `surg_msgs/RecordStatus`; all fields default: no valid and fresh one."""
        return self._valid("/record/status", fresh=True)

    @property
    def policy(self) -> Any:
        """The newest valid `surg_msgs/PolicyStatus`; all fields default before the first."""
        return self._valid("/policy/status")

    def problem(self, topic: str) -> str:
        """Why the status on a topic may not be acted on now; empty: it may."""
        with self._lock:
            return str(self._statuses[topic].problem(time.monotonic()))

    def _valid(self, topic: str, fresh: bool = False) -> Any:
        """The newest valid status; a default message decides nothing, since 0 is no state."""
        with self._lock:
            newest = self._statuses[topic]
            message = newest.at(time.monotonic()) if fresh else newest.valid
            return self._kinds[topic]() if message is None else message

    @property
    def states(self) -> dict[str, str]:
        """Arm -> its newest operating state."""
        with self._lock:
            return dict(self._states)

    @property
    def fault(self) -> str:
        """The first arm that went into FAULT, after `FAULT_GRACE_S`, and its error; empty: none."""
        with self._lock:
            if self._fault is None or time.monotonic() - self._fault[1] <= FAULT_GRACE_S:
                return ""
            arm = self._fault[0]
            return f"{arm} went into FAULT: {self._errors.get(arm) or 'it gave no reason'}"

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

    def _on_status(self, message: Any, topic: str) -> None:
        now = time.monotonic()
        with self._lock:
            newest = self._statuses[topic]
            before = newest.valid
            newest.take(message, now)
            complaint = newest.complaint(now)
            if newest.valid is None:
                pass
            elif topic == "/sim/status" and (before is None or message.tick != before.tick):
                self._sim_changed = now
            elif hasattr(message, "STAGE_FAILED") and message.stage == message.STAGE_FAILED:
                self._gave_up[topic.split("/")[1]] = message.detail or "it gave no reason"
        if complaint:
            warn(f"surg: {complaint}")

    def _on_recording(self, message: Any) -> None:
        self.recording = bool(message.data)

    def _on_state(self, message: Any, arm: str) -> None:
        with self._lock:
            self._states[arm] = message.state
            if message.state == "FAULT" and self._fault is None:
                self._fault = arm, time.monotonic()

    def _on_text(self, message: Any, origin: tuple[str, str]) -> None:
        with self._lock:
            self._news.append((" ".join(origin), message.data))
            if origin[1] == "error":
                self._errors[origin[0]] = message.data
