"""The recorder node: topics in, one episode folder out. Wiring only; ``recording`` does the work.

Parameters (private): ``out`` folder of the episode, ``cell`` folder or file, ``mode`` lockstep or
freerun, ``arms`` and ``cameras`` (lists; a camera is a topic ``/a/b/image_raw`` or its name
``a_b``), ``run_info`` (JSON: robot, motion, task, operator, …), ``autostart`` (default true: record
from the first message; false: wait for /record/record), ``min_free_bytes``, ``video_preset``.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import sys
import threading
import time
from pathlib import Path
from typing import Any

import rospy
from geometry_msgs.msg import PoseStamped, TwistStamped
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import Bool, Empty, String

from crtk_msgs.msg import OperatingState
from surg_msgs.msg import Cycle, GroundTruth, Ready, TaskState
from surg_recording import provenance, rows
from surg_recording.episode_writer import MIN_FREE_BYTES, recover
from surg_recording.errors import EpisodeError
from surg_recording.recording import Recording

COMMANDS: dict[str, type] = {
    "servo_cp": PoseStamped,
    "servo_jp": JointState,
    "servo_jr": JointState,
    "servo_cv": TwistStamped,
    "servo_jv": JointState,
    "interpolate_cp": PoseStamped,
    "interpolate_jp": JointState,
    "move_cp": PoseStamped,
    "move_jp": JointState,
    "move_jr": JointState,
    "jaw/servo_jp": JointState,
    "jaw/move_jp": JointState,
}
"""Command topics of an arm that go to ``command_<arm>.csv``."""

ASSISTANT = ("servo_jp", "jaw/servo_jp")
"""Command topics of the assistant's instrument that go to ``command_assistant.csv``."""

TASK_TOPIC = "/sim/task_state"

READY_TICKS = 25
TICK_NS = 2_000_000
PACE_S = 0.01
STATUS_S = 0.2
SETTLE_S = 0.3
STOP_WAIT_S = 10.0
FRAME_WAIT_S = 2.0


@dataclasses.dataclass(frozen=True)
class Settings:
    """The node's parameters, read once."""

    out: Path
    cell: Path | None
    mode: str
    arms: tuple[str, ...]
    cameras: dict[str, str]
    """Name → topic."""
    run_info: dict[str, Any]
    autostart: bool
    min_free_bytes: int
    video_preset: str

    @classmethod
    def from_parameters(cls) -> Settings:
        """Read and check.

        Raises:
            ValueError: parameter, value and what is allowed.
        """
        out = str(rospy.get_param("~out", ""))
        if not out:
            raise ValueError("parameter ~out is missing: the folder the episode is written to")
        mode = rospy.get_param("~mode", "lockstep")
        if mode not in ("lockstep", "freerun"):
            raise ValueError(f"parameter ~mode is {mode!r}, allowed are lockstep and freerun")
        arms = _names(rospy.get_param("~arms", ["PSM1"]), "~arms")
        if not arms:
            raise ValueError("parameter ~arms is empty: at least one arm, e.g. [PSM1]")
        info = rospy.get_param("~run_info", {})
        try:
            info = json.loads(info) if isinstance(info, str) and info else info or {}
        except ValueError as problem:
            raise ValueError(f"parameter ~run_info is no valid JSON ({problem})") from problem
        if not isinstance(info, dict):
            raise ValueError("parameter ~run_info must be a JSON object")
        cell = rospy.get_param("~cell", "")
        free = rospy.get_param("~min_free_bytes", MIN_FREE_BYTES)
        if isinstance(free, bool) or not isinstance(free, (int, float)) or not free >= 0:
            raise ValueError(f"parameter ~min_free_bytes is {free!r}, must be a number >= 0")
        return cls(
            out=Path(out).resolve(),
            cell=Path(str(cell)).resolve() if cell else None,
            mode=mode,
            arms=tuple(name.strip("/") for name in arms),
            cameras=dict(map(_camera, _names(rospy.get_param("~cameras", []), "~cameras"))),
            run_info=info,
            autostart=bool(rospy.get_param("~autostart", True)),
            min_free_bytes=int(free),
            video_preset=str(rospy.get_param("~video_preset", "ultrafast")),
        )


def _names(value: Any, parameter: str) -> list[str]:
    """A list parameter; also taken from a command line as ``a,b`` or ``[a, b]``."""
    if isinstance(value, str):
        value = value.strip("[]").split(",")
    if not isinstance(value, list):
        raise ValueError(f"parameter {parameter} is {value!r}, must be a list of names")
    return [name for name in (str(item).strip(" '\"") for item in value) if name]


def _camera(given: str) -> tuple[str, str]:
    """Name and topic of a camera from either."""
    if given.startswith("/"):
        return given.removesuffix("/image_raw").strip("/").replace("/", "_"), given
    head, _, tail = given.rpartition("_")
    return given, f"/{head}/{tail}/image_raw" if head else f"/{given}/image_raw"


class RecorderNode:
    """Topics, start and stop."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.lockstep = settings.mode == "lockstep"
        self.recording: Recording | None = None
        self.problem: str | None = None
        self.finished: str | None = None
        self.finishing = False
        self.sim_status: dict[str, Any] = {}
        self._switch = threading.RLock()
        self._received: dict[str, int] = {}
        for arm in settings.arms:
            self._received[f"cycle_{arm}"] = self._received[f"ground_truth_{arm}"] = 0
        self._last_row = time.monotonic()
        self._states: dict[str, str] = {}
        self._status = rospy.Publisher("/record/status", String, queue_size=10, latch=True)
        self._recording = rospy.Publisher("/record/recording", Bool, queue_size=10, latch=True)
        for folder in recover(settings.out.parent, settings.out.name):
            rospy.logwarn("an earlier recording was cut off; what it held is now in %s", folder)
        self._recording.publish(False)
        if settings.autostart:
            self.start()
        self._subscribers = self._subscribe()
        rospy.on_shutdown(self.stop)
        threading.Thread(target=self._pace, name="pace", daemon=True).start()

    # --- start and stop ---

    def start(self) -> None:
        """Begin an episode; a second start while recording does nothing."""
        with self._switch:
            if self.recording is not None:
                return
            s = self.settings
            manifest: dict[str, Any] = {
                "run": s.run_info,
                "task": s.run_info.get("task"),
                "operator": s.run_info.get("operator"),
                "seed": s.run_info.get("seed"),
                "clock": "simulator ticks" if self.lockstep else "wall clock",
                "started_ns": time.time_ns(),
                "cell": provenance.describe_cell(s.cell) if s.cell else None,
                "versions": provenance.versions(),
            }
            try:
                self.recording = Recording(
                    s.out,
                    mode=s.mode,
                    arms=s.arms,
                    cameras=list(s.cameras),
                    manifest=manifest,
                    min_free_bytes=s.min_free_bytes,
                    video_preset=s.video_preset,
                )
                self.problem = self.finished = None
            except EpisodeError as problem:
                self.problem = str(problem)
                rospy.logerr("recording does not start: %s", problem)
            for arm, text in self._states.items():
                self._event(f"/{arm}/operating_state", "", text)
            self._announce()

    def stop(self) -> None:
        """End the episode: wait for what is under way, write it, finish the folder."""
        with self._switch:
            recording = self.recording
            if recording is None:
                return
            self.finishing = True
            if not recording.failed:
                self._settle(recording)
            self.recording = None
            try:
                self.finished = str(
                    recording.close({"sim": self.sim_status, "stopped_ns": time.time_ns()})
                )
                self.problem = recording.problem
            except EpisodeError as problem:
                self.problem = str(problem)
            self.finishing = False
            if self.problem:
                rospy.logerr("recording incomplete: %s", self.problem)
            self._announce()

    def _settle(self, recording: Recording) -> None:
        """Wait until everything that was sent before the stop has come in."""
        deadline = time.monotonic() + STOP_WAIT_S
        while time.monotonic() < deadline:
            if time.monotonic() - self._last_row > SETTLE_S:
                break
            time.sleep(0.02)
        if self.lockstep:
            # In lock-step cameras may be many frames behind the ticks: wait for the frame that
            # belongs to the last tick.
            for camera in self.settings.cameras:
                self._await_frames(recording, camera, self._ticks() * TICK_NS)

    def _await_frames(self, recording: Recording, camera: str, end_ns: int) -> None:
        """Wait until a camera has no frame due before ``end_ns``, while frames come in."""
        since, newest = time.monotonic(), -1
        while time.monotonic() - since < FRAME_WAIT_S:
            last, period = recording.newest_image(camera)
            if not last or last > end_ns - period:
                return
            if last != newest:
                since, newest = time.monotonic(), last
            time.sleep(0.02)
        last, period = recording.newest_image(camera)
        if last + 2 * period <= end_ns:  # one frame more or less is the end's own uncertainty
            recording.note(f"{camera}: ends {(end_ns - last) * 1e-9:.2f} s before the motion")

    # --- topics ---

    def _subscribe(self) -> dict[str, rospy.Subscriber]:
        found: dict[str, rospy.Subscriber] = {}

        def on(topic: str, kind: type, call: Any, *arguments: Any) -> None:
            found[topic] = rospy.Subscriber(
                topic,
                kind,
                functools.partial(call, *arguments),
                queue_size=None,
                buff_size=1 << 20 if kind is Image else 1 << 16,
                tcp_nodelay=True,
            )

        for arm in self.settings.arms:
            on(f"/{arm}/cycle", Cycle, self._on_cycle, arm)
            for name, kind in COMMANDS.items():
                on(f"/{arm}/{name}", kind, self._on_command, arm, name)
            on(f"/{arm}/hold", Empty, self._on_hold, arm)
            on(f"/{arm}/operating_state", OperatingState, self._on_state, arm)
            for name in ("error", "warning", "status"):
                on(f"/{arm}/{name}", String, self._on_text, f"/{arm}/{name}")
        on("/sim/ground_truth/state", GroundTruth, self._on_truth)
        on(TASK_TOPIC, TaskState, self._on_task_state)
        for name in ASSISTANT:
            on(f"/assistant/{name}", JointState, self._on_assistant, name)
        on("/sim/status", String, self._on_sim_status)
        for camera, topic in self.settings.cameras.items():
            on(topic, Image, self._on_image, camera)
        on("/record/record", Bool, self._on_record)
        return found

    def _on_cycle(self, arm: str, message: Cycle) -> None:
        if self.recording is not None:
            self.recording.cycle(arm, message, time.time_ns())
        self._received[f"cycle_{arm}"] = message.tick
        self._last_row = time.monotonic()

    def _on_truth(self, message: GroundTruth) -> None:
        if self.recording is not None:
            self.recording.ground_truth(message, time.time_ns())
        for arm in message.arms:
            self._received[f"ground_truth_{arm.arm}"] = message.tick
        self._last_row = time.monotonic()

    def _on_command(self, arm: str, topic: str, message: Any) -> None:
        if self.recording is not None:
            self.recording.command(arm, topic, message, _sender(message), time.time_ns())

    def _on_task_state(self, message: TaskState) -> None:
        if self.recording is not None:
            self.recording.task_state(message, time.time_ns())
        self._last_row = time.monotonic()

    def _on_assistant(self, topic: str, message: JointState) -> None:
        if self.recording is not None:
            self.recording.assistant_command(topic, message, _sender(message), time.time_ns())

    def _on_hold(self, arm: str, message: Empty) -> None:
        self._event(f"/{arm}/hold", _sender(message), "")

    def _on_state(self, arm: str, message: OperatingState) -> None:
        text = rows.operating_state(message)
        if text != self._states.get(arm):
            self._states[arm] = text
            stamp = rows.nanoseconds(message.header.stamp)
            self._event(f"/{arm}/operating_state", _sender(message), text, stamp)

    def _on_text(self, topic: str, message: String) -> None:
        self._event(topic, _sender(message), message.data)

    def _on_sim_status(self, message: String) -> None:
        try:
            status = json.loads(message.data)
        except ValueError:
            status = None
        if not isinstance(status, dict):
            rospy.logwarn_throttle(10, "/sim/status is no JSON object: %s", message.data[:200])
            return
        ended = bool(status.get("done") or status.get("aborted"))
        news = ended and not (self.sim_status.get("done") or self.sim_status.get("aborted"))
        self.sim_status = status
        if news:
            self._event("/sim/status", _sender(message), message.data)

    def _on_image(self, camera: str, message: Image) -> None:
        recording = self.recording
        if recording is not None:
            recording.image(camera, message, time.time_ns())

    def _on_record(self, message: Bool) -> None:
        threading.Thread(target=self.start if message.data else self.stop, daemon=True).start()

    def _event(self, topic: str, source: str, text: str, stamp_ns: int = 0) -> None:
        if self.recording is not None:
            self.recording.event(topic, source, text, time.time_ns(), stamp_ns)

    # --- flow control and status ---

    def _ticks(self) -> int:
        """Newest tick that has been received whole."""
        return min(self._received.values())

    def _pace(self) -> None:
        """Thread: Ready in lock-step, status, a look at the disk."""
        ready = self._ready_publisher() if self.lockstep else None
        sent = 0
        given_up: Recording | None = None
        sent_at = status_at = time.monotonic()
        while not rospy.is_shutdown():
            time.sleep(PACE_S)
            now, recording = time.monotonic(), self.recording
            tick = recording.written_tick() if recording is not None else self._ticks()
            if recording is not None and recording.failed:
                tick = self._ticks()  # a broken disk does not hold up the simulation
                if recording is not given_up:
                    given_up = recording
                    threading.Thread(target=self.stop, daemon=True).start()
            due = tick >= sent + READY_TICKS or (tick > sent and now - sent_at > 5 * PACE_S)
            if ready is not None and due:
                ready.publish(Ready(tick=tick, participant="recorder"))
                sent, sent_at = tick, now
            if now - status_at > STATUS_S:
                status_at = now
                self._publish_status()

    def _ready_publisher(self) -> rospy.Publisher:
        """Advertise /sim/ready once everything to be recorded is connected.

        The simulator waits for this connection before its first tick, so no tick is missed.
        """
        needed = [f"/{arm}/cycle" for arm in self.settings.arms]
        needed += ["/sim/ground_truth/state", *self.settings.cameras.values()]
        commands = [f"/{arm}/{name}" for arm in self.settings.arms for name in COMMANDS]
        complete_since = None
        while not rospy.is_shutdown():
            missing = [t for t in needed if self._subscribers[t].get_num_connections() == 0]
            if not missing and self._waits_for_task():
                missing = [TASK_TOPIC]
            if missing:
                rospy.loginfo_throttle(2, "recorder: waiting for %s", ", ".join(missing))
            else:
                complete_since = complete_since or time.monotonic()
                commanded = any(self._subscribers[t].get_num_connections() for t in commands)
                if commanded or time.monotonic() - complete_since > 1.0:
                    break
            time.sleep(0.02)
        return rospy.Publisher("/sim/ready", Ready, queue_size=0, tcp_nodelay=True)

    def _waits_for_task(self) -> bool:
        """Whether there is a task whose state does not reach this node yet.

        The simulator opens the topic before that of ground truth, which is connected by now.
        """
        if self._subscribers[TASK_TOPIC].get_num_connections():
            return False
        return any(topic == TASK_TOPIC for topic, _ in rospy.get_published_topics("/sim"))

    def _announce(self) -> None:
        # The status first: who sees the flag change finds the reason there.
        self._publish_status()
        self._recording.publish(self.recording is not None)

    def _publish_status(self) -> None:
        recording = self.recording
        status: dict[str, Any] = {
            "recording": recording is not None,
            "finishing": self.finishing,
            "finished": self.finished,
            "problem": self.problem,
            "tick": self._ticks(),
        }
        if recording is not None:
            status.update(recording.status())
        self._status.publish(json.dumps(status))


def _sender(message: Any) -> str:
    """Caller id of the node that sent a message."""
    return str(message._connection_header.get("callerid", ""))


def main() -> int:
    """Run the node; returns the exit code (2: broken parameters)."""
    rospy.init_node("recorder")
    try:
        settings = Settings.from_parameters()
    except ValueError as problem:
        print(f"recorder: {problem}", file=sys.stderr)
        return 2
    RecorderNode(settings)
    rospy.spin()
    return 0
