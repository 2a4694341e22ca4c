"""The recorder node: topics in, one episode folder out. Wiring only; ``recording`` does the work.

Parameters (private): ``out`` folder of the episode, ``cell`` folder or file, ``mode`` lockstep or
freerun, ``arms`` and ``cameras`` (lists; a camera is a topic of raw or compressed images, or the
name ``a_b`` of ``/a/b/image_raw``), ``topics`` (names and patterns of any others), ``run_info``
(JSON: robot, motion, task, operator, …), ``autostart`` (default true: record from the first
message; false: wait for /record/record), ``min_free_bytes``, ``video_preset``.
"""

from __future__ import annotations

import functools
import hashlib
import json
import subprocess
import sys
import threading
import time
import xmlrpc.client
from pathlib import Path
from typing import Any

import rosgraph
import roslib.message
import rospy
from geometry_msgs.msg import PoseStamped, TwistStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Empty, String

from crtk_msgs.msg import OperatingState
from surg_core.contract import GRID, TICK_NS
from surg_core.status_check import Newest
from surg_msgs.msg import (
    ClockSync,
    Cycle,
    GroundTruth,
    Ready,
    RecordStatus,
    SimStatus,
    TaskState,
)
from surg_recording.clock.clock_steps import SteppedClock
from surg_recording.episode import annotations, provenance, table_rows
from surg_recording.episode.duplicate_filter import DuplicateFilter
from surg_recording.episode.episode_reader import PARTIAL
from surg_recording.episode.episode_recorder import Recording
from surg_recording.episode.message_fields import Flat
from surg_recording.episode.recovery import recover
from surg_recording.episode.topic_selection import IMAGES, NOT_TABLES, TopicChoice
from surg_recording.nodes.recorder_parameters import Settings
from surg_recording.nodes.status_messages_node import describe_recording, simulation_outcome
from surg_recording.recording_errors import EpisodeError
from surg_ros.params import read

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
CLOCK_TOPIC = "/clock_sync/status"

FACTS = ("task", "setting", "operator", "seed")
"""Facts about a run that stand in the manifest by themselves."""

PACE_S = 0.01
STATUS_S = 0.2
SETTLE_S = 0.3
STOP_WAIT_S = 10.0
FREERUN_STOP_S = 0.5
FRAME_WAIT_S = 2.0
DISCOVER_S = 1.0
MASTER_TIMEOUT_S = 2.0
SILENT_S = 5.0
LONG_PARAMETER = 2000


class RecorderNode:
    """Topics, start and stop."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.lockstep = settings.mode == "lockstep"
        self.recording: Recording | None = None
        self.problem: str | None = None
        self.finished: str | None = None
        self.finishing = False
        self.starts = 0
        self._started = False  # the last start succeeded
        self.warnings: list[str] = []
        self.sim_status: dict[str, Any] = {}
        self._sim = Newest("/sim/status")
        self._switch = threading.RLock()
        self._received: dict[str, int] = {}
        for arm in settings.arms:
            self._received[f"cycle_{arm}"] = self._received[f"ground_truth_{arm}"] = 0
        self._last_row = time.monotonic()
        self._states: dict[str, str] = {}
        self._info: dict[str, Any] = {}
        self._duplicate_filters: dict[tuple[str, str], DuplicateFilter] = {}
        self._clock = SteppedClock(self._on_clock_step)
        taken = frozenset((*self._own_topics(), *settings.camera_topics.values()))
        self.choice = TopicChoice(list(settings.topics), taken)
        self._classes: dict[tuple[str, str], Any] = {}
        self._status = rospy.Publisher("/record/status", RecordStatus, queue_size=10, latch=True)
        self._recording = rospy.Publisher("/record/recording", Bool, queue_size=10, latch=True)
        _recover(settings.out.parent, settings.out.name)
        self._recording.publish(False)
        if settings.autostart:
            self.start()
        self._subscribers = self._subscribe()
        rospy.on_shutdown(self.stop)
        threading.Thread(target=self._pace, name="pace", daemon=True).start()
        threading.Thread(target=self._discover, name="discover", daemon=True).start()

    # --- start and stop ---

    def start(self) -> None:
        """Begin an episode; a second start while recording does nothing."""
        with self._switch:
            if self.recording is not None:
                return
            s = self.settings
            manifest: dict[str, Any] = {
                **self._facts(),
                "clock": "simulator ticks" if self.lockstep else "wall clock",
                "started_ns": self._clock.now_ns(),
                "cell": provenance.describe_cell(s.cell) if s.cell else None,
                "parameters": _parameters(),
                "versions": provenance.versions(),
                "host": provenance.host(),
            }
            self._duplicate_filters = {}
            try:
                self.recording = Recording(
                    s.out,
                    mode=s.mode,
                    arms=s.arms,
                    cameras=list(s.camera_topics),
                    manifest=manifest,
                    min_free_bytes=s.min_free_bytes,
                    video_preset=s.video_preset,
                )
                self.problem = self.finished = None
                self._started = True
            except EpisodeError as problem:
                self.problem, self._started = str(problem), False
                rospy.logerr("recording does not start: %s", problem)
            self.starts += 1
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
            self._warn_of_silence(recording)
            stopped = self._clock.now_ns()
            try:
                repeats = self._repeats()
                folder = recording.close(
                    {
                        **self._facts(),
                        "sim": self.sim_status,
                        "stopped_ns": stopped,
                        "repeats": repeats,
                    },
                    topics=self.choice.describe(repeats),
                    end_stamp_ns=self._episode_now(stopped),
                )
                self.finished, self.problem = str(folder), recording.problem
                self._examine(folder)
            except EpisodeError as problem:
                self.problem = str(problem)
            except Exception as problem:  # never a silent end: the folder stays and is mended later
                self.problem = f"not finished: {type(problem).__name__}: {problem}"
            finally:
                self.finishing = False
                self.warnings = recording.warnings
            if self.problem:
                rospy.logerr("recording incomplete: %s", self.problem)
            self._announce()

    def _examine(self, folder: Path) -> None:
        """Have sync.json made by a process of its own: it decodes the videos and must not disturb.

        It is not waited for: the next episode can start at once.
        """
        argv = [sys.executable, "-m", "surg_recording.clock.sync_report", "--quiet", str(folder)]
        try:
            subprocess.Popen(
                ["nice", "-n", "10", *argv],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                start_new_session=True,
            )
        except OSError as problem:
            rospy.logwarn("no sync.json: %s", problem.strerror)

    def _facts(self) -> dict[str, Any]:
        """What is known of the run: by parameter, and by /record/info since."""
        run = {**self.settings.run_info, **self._info}
        return {"run": run, **{key: run.get(key) for key in FACTS}}

    def _repeats(self) -> dict[str, int]:
        """Topic → messages that came twice over two connections."""
        found: dict[str, int] = {}
        for (topic, _), duplicate_filter in list(self._duplicate_filters.items()):
            found[topic] = found.get(topic, 0) + duplicate_filter.duplicates
        return {topic: count for topic, count in found.items() if count}

    def _warn_of_silence(self, recording: Recording) -> None:
        """Name what was asked for and never came."""
        messages = {topic: entry["messages"] for topic, entry in recording.topics().items()}
        for topic in self.choice.silent(messages):
            recording.warn(f"{topic}: nothing was received")
        for topic, why in self.choice.refused.items():
            recording.warn(f"{topic}: not recorded as a table: {why}")

    def _settle(self, recording: Recording) -> None:
        """Wait until everything that was sent before the stop has come in."""
        # In free-run the arms never fall silent: what is under way needs no longer than this.
        deadline = time.monotonic() + (STOP_WAIT_S if self.lockstep else FREERUN_STOP_S)
        while time.monotonic() < deadline:
            if time.monotonic() - self._last_row > SETTLE_S:
                break
            time.sleep(0.02)
        if self.lockstep:
            # In lock-step cameras may be many frames behind the ticks: wait for the frame that
            # belongs to the last tick.
            for camera in self.settings.camera_topics:
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
                buff_size=1 << 20 if call == self._on_image else 1 << 16,
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
        on("/sim/status", SimStatus, self._on_sim_status)
        for camera, topic in self.settings.camera_topics.items():
            on(topic, rospy.AnyMsg, self._on_image, camera)
        on(CLOCK_TOPIC, ClockSync, self._on_clock_sync)
        on("/record/record", Bool, self._on_record)
        on("/record/tag", String, self._on_tag)
        on("/record/info", String, self._on_info)
        for topic in self.choice.named:
            if topic in self.choice.chosen:
                on(topic, rospy.AnyMsg, self._on_any, topic)
        self._listen = on
        return found

    def _own_topics(self) -> list[str]:
        """Topics with a table of their own kind."""
        arms = self.settings.arms
        names = [*COMMANDS, "cycle", "hold", "operating_state", "error", "warning", "status"]
        return [
            *(f"/{arm}/{name}" for arm in arms for name in names),
            *(f"/assistant/{name}" for name in ASSISTANT),
            *("/sim/ground_truth/state", TASK_TOPIC, "/sim/status", CLOCK_TOPIC),
            *("/record/record", "/record/tag", "/record/info"),
        ]

    def _repeated(self, topic: str, message: Any, key: Any) -> bool:
        """Whether a second connection to the same publisher has brought this message before."""
        header = message._connection_header  # one object for each connection
        publisher = (topic, str(header.get("callerid", "")))
        duplicate_filter = self._duplicate_filters.get(publisher)
        if duplicate_filter is None:
            duplicate_filter = self._duplicate_filters.setdefault(publisher, DuplicateFilter())
        return duplicate_filter.is_duplicate(id(header), key, time.monotonic())

    def _on_cycle(self, arm: str, message: Cycle) -> None:
        recording = self.recording
        if recording is not None and not self._repeated(f"/{arm}/cycle", message, _key(message)):
            recording.cycle(arm, message, self._clock.now_ns())
        self._received[f"cycle_{arm}"] = message.tick
        self._last_row = time.monotonic()

    def _on_truth(self, message: GroundTruth) -> None:
        recording = self.recording
        topic = "/sim/ground_truth/state"
        if recording is not None and not self._repeated(topic, message, _key(message)):
            recording.ground_truth(message, self._clock.now_ns())
        for arm in message.arms:
            self._received[f"ground_truth_{arm.arm}"] = message.tick
        self._last_row = time.monotonic()

    def _on_command(self, arm: str, topic: str, message: Any) -> None:
        recording = self.recording
        if recording is None or self._repeated(f"/{arm}/{topic}", message, _key(message)):
            return
        recording.command(arm, topic, message, _sender(message), self._clock.now_ns())

    def _on_task_state(self, message: TaskState) -> None:
        recording = self.recording
        if recording is not None and not self._repeated(TASK_TOPIC, message, _key(message)):
            recording.task_state(message, self._clock.now_ns())
        self._last_row = time.monotonic()

    def _on_clock_sync(self, message: ClockSync) -> None:
        recording = self.recording
        if recording is not None and not self._repeated(CLOCK_TOPIC, message, _key(message)):
            recording.clock_sync(message, self._clock.now_ns())

    def _on_assistant(self, topic: str, message: JointState) -> None:
        recording = self.recording
        if recording is None or self._repeated(f"/assistant/{topic}", message, _key(message)):
            return
        recording.assistant_command(topic, message, _sender(message), self._clock.now_ns())

    def _on_hold(self, arm: str, message: Empty) -> None:
        if not self._repeated(f"/{arm}/hold", message, ""):
            self._event(f"/{arm}/hold", _sender(message), "")

    def _on_state(self, arm: str, message: OperatingState) -> None:
        text = table_rows.operating_state(message)
        again = self._repeated(f"/{arm}/operating_state", message, _key(message))
        if text != self._states.get(arm) and not again:
            self._states[arm] = text
            stamp = table_rows.nanoseconds(message.header.stamp)
            self._event(f"/{arm}/operating_state", _sender(message), text, stamp)

    def _on_text(self, topic: str, message: String) -> None:
        if not self._repeated(topic, message, message.data):
            self._event(topic, _sender(message), message.data)

    def _on_sim_status(self, message: SimStatus) -> None:
        now = time.monotonic()
        self._sim.take(message, now)
        if complaint := self._sim.complaint(now):
            rospy.logwarn("recorder: not in the manifest: %s", complaint)
        if self._sim.at(now) is None:
            return
        before, self.sim_status = self.sim_status, simulation_outcome(message)
        ended = message.state != SimStatus.STATE_RUNNING
        if ended and not (before.get("done") or before.get("aborted")):
            text = json.dumps(self.sim_status)
            self._event("/sim/status", _sender(message), text)

    def _on_image(self, camera: str, message: Any) -> None:
        """A picture still in its wire form: raw or compressed is its sender's choice."""
        recording = self.recording
        if recording is None:
            return
        received, topic = self._clock.now_ns(), self.settings.camera_topics[camera]
        found, why = self._installed(message)
        if found is not None and found._type not in IMAGES:
            why = f"its type is {found._type}; images are {' and '.join(IMAGES)}"
        if why is not None:
            recording.warn(f"{topic}: not recorded as a camera: {why}")
            return
        try:
            image = found().deserialize(message._buff)
        except Exception as problem:  # genpy raises whatever the bytes make it stumble over
            recording.warn(
                f"{topic}: a message that is no {found._type} ({type(problem).__name__})"
            )
            return
        if not self._repeated(topic, message, _key(image)):
            recording.image(camera, image, received)

    def _on_any(self, topic: str, message: Any) -> None:
        """A message of a topic that has no table of its own kind, still in its wire form."""
        recording = self.recording
        if recording is None or self._repeated(topic, message, message._buff):
            return
        received = self._clock.now_ns()
        kind = str(message._connection_header.get("type", ""))
        found, why = self._installed(message)
        why = NOT_TABLES.get(kind, why)
        if why is not None:
            if self.choice.refuse(topic, why):
                rospy.logwarn("recorder: %s is not recorded: %s", topic, why)
            return
        try:
            flat = Flat(found().deserialize(message._buff))
        except Exception as problem:  # genpy raises whatever the bytes make it stumble over
            recording.warn(f"{topic}: a message that is no {kind} ({type(problem).__name__})")
            return
        recording.topic(topic, kind, flat, _sender(message), received)

    def _installed(self, message: Any) -> tuple[Any, str | None]:
        """The installed class of a message in its wire form; None, and why there is none."""
        header = message._connection_header
        kind, md5 = str(header.get("type", "")), str(header.get("md5sum", ""))
        if (kind, md5) not in self._classes:
            self._classes[kind, md5] = roslib.message.get_message_class(kind)
        found = self._classes[kind, md5]
        if found is None:
            return None, f"its type {kind} is not installed here"
        if found._md5sum != md5:
            return None, f"its sender has another definition of {kind} than this machine"
        return found, None

    def _on_tag(self, message: String) -> None:
        recording, source = self.recording, _sender(message)
        if self._repeated("/record/tag", message, message.data):
            return
        if recording is None:
            rospy.logwarn("recorder: a tag while nothing is recorded: %s", message.data[:200])
            return
        try:
            said = annotations.parse_tag(message.data)
        except ValueError as problem:
            rospy.logwarn("recorder: %s", problem)
            return
        now = self._clock.now_ns()
        recording.tag(said, message.data, source, now, self._episode_now(now))

    def _on_info(self, message: String) -> None:
        try:
            self._info = {**self._info, **annotations.parse_info(message.data)}
        except ValueError as problem:
            rospy.logwarn("recorder: %s", problem)

    def _on_clock_step(self, step_ns: int, wall_ns: int) -> None:
        # Every callback waits for this: the log, which may be slow, is written by another thread.
        if self.recording is not None:
            self.recording.clock_stepped(step_ns, wall_ns)
        said = ("recorder: the clock was set by %+.3f s", step_ns * 1e-9)
        threading.Thread(target=rospy.logwarn, args=said, daemon=True).start()

    def _episode_now(self, wall_ns: int) -> int:
        """Now on the clock of the episode's stamps [ns]."""
        return self._ticks() * TICK_NS if self.lockstep else wall_ns

    def _on_record(self, message: Bool) -> None:
        threading.Thread(target=self.start if message.data else self.stop, daemon=True).start()

    def _event(self, topic: str, source: str, text: str, stamp_ns: int = 0) -> None:
        if self.recording is not None:
            self.recording.event(topic, source, text, self._clock.now_ns(), stamp_ns)

    # --- what appears later ---

    def _discover(self) -> None:
        """Thread: listen to what the patterns match, and tell of what stays silent."""
        lost = False
        told: set[str] = set()
        quiet_since = time.monotonic()
        while not rospy.is_shutdown():
            try:
                published = dict(_master().getPublishedTopics(rospy.get_name(), "")[2])
            except (OSError, xmlrpc.client.Error, ValueError, TypeError) as problem:
                if not lost:
                    rospy.logwarn("recorder: no answer from the ROS master (%s): what is", problem)
                    rospy.logwarn("connected is recorded on, new topics are not found")
                lost, published = True, {}
            else:
                lost = False
            for topic in self.choice.look(published):
                self._listen(topic, rospy.AnyMsg, self._on_any, topic)
            recording = self.recording
            if recording is None:
                told, quiet_since = set(), time.monotonic()
            elif time.monotonic() - quiet_since > SILENT_S:
                for name in sorted(set(self._waiting_for(recording)) - told):
                    told.add(name)
                    rospy.logwarn("recorder: nothing has come on %s yet", name)
            time.sleep(DISCOVER_S)

    def _waiting_for(self, recording: Recording) -> list[str]:
        """What was asked for and has not sent anything in this recording."""
        messages = {topic: entry["messages"] for topic, entry in recording.topics().items()}
        cameras = [
            topic
            for name, topic in self.settings.camera_topics.items()
            if not recording.newest_image(name)[0]
        ]
        return [*cameras, *self.choice.silent(messages)]

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
            wall = self._clock.now_ns()  # so that a step is noticed when nothing comes in
            if recording is not None:
                recording.watch_cameras(now, wall)
            tick = recording.written_tick() if recording is not None else self._ticks()
            if recording is not None and recording.failed:
                tick = self._ticks()  # a broken disk does not hold up the simulation
                if recording is not given_up:
                    given_up = recording
                    threading.Thread(target=self.stop, daemon=True).start()
            due = tick >= sent + GRID or (tick > sent and now - sent_at > 5 * PACE_S)
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
        needed += ["/sim/ground_truth/state", *self.settings.camera_topics.values()]
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
        state = RecordStatus.STATE_IDLE if recording is None else RecordStatus.STATE_RECORDING
        message = RecordStatus(
            version=RecordStatus.VERSION,
            state=RecordStatus.STATE_FINISHING if self.finishing else state,
            problem=self._problem_code(recording),
            detail=self.problem or "",
            starts=self.starts,
            tick=self._ticks(),
            finished=self.finished or "",
            warnings=self.warnings,
        )
        message.header.stamp = rospy.Time(*divmod(time.time_ns(), 10**9))
        if recording is not None:
            describe_recording(message, recording, self._waiting_for(recording))
            message.detail = recording.problem or ""
        self._status.publish(message)

    def _problem_code(self, recording: Recording | None) -> int:
        if recording is not None:
            bad = bool(recording.problem)
            return RecordStatus.PROBLEM_INCOMPLETE if bad else RecordStatus.PROBLEM_NONE
        if not self.problem:
            return RecordStatus.PROBLEM_NONE
        started = self._started
        return RecordStatus.PROBLEM_INCOMPLETE if started else RecordStatus.PROBLEM_NOT_STARTED


def _sender(message: Any) -> str:
    """Caller id of the node that sent a message."""
    return str(message._connection_header.get("callerid", ""))


def _key(message: Any) -> tuple[int, int]:
    """What tells the messages of one publisher apart."""
    return message.header.seq, table_rows.nanoseconds(message.header.stamp)


def _recover(parent: Path, name: str) -> None:
    """Finish what killed recorders left: of this name now, elsewhere in a moment."""

    def tell(folders: list[Path]) -> None:
        for folder in folders:
            rospy.logwarn("an earlier recording was cut off; what it held is now in %s", folder)

    def refused(problem: str) -> None:
        rospy.logerr("an earlier recording cannot be recovered: %s", problem)

    def elsewhere() -> None:
        # Every run has a folder of its own: those beside this one.
        for run in sorted({found.parent for found in parent.parent.glob(f"*/{name}*{PARTIAL}")}):
            if run != parent:
                tell(recover(run, name, refused))

    tell(recover(parent, name, refused))
    threading.Thread(target=elsewhere, name="recover", daemon=True).start()


class _Timed(xmlrpc.client.Transport):
    """Gives up on a master that hangs."""

    def make_connection(self, host: Any) -> Any:
        connection = super().make_connection(host)
        connection.timeout = MASTER_TIMEOUT_S
        return connection


def _master() -> Any:
    return xmlrpc.client.ServerProxy(rosgraph.get_master_uri(), transport=_Timed())


def _parameters() -> dict[str, Any] | None:
    """Every parameter of the system by name, long texts as their SHA-256; None: no master."""
    try:
        tree = _master().getParam(rospy.get_name(), "/")[2]
    except (OSError, xmlrpc.client.Error, ValueError):
        return None

    def short(value: Any) -> Any:
        if isinstance(value, dict):
            return {str(key): short(item) for key, item in value.items()}
        text = value if isinstance(value, str) else json.dumps(value, default=str)
        if len(text) <= LONG_PARAMETER:
            return value
        return f"sha256:{hashlib.sha256(text.encode('utf-8', 'replace')).hexdigest()}"

    found = short(tree)
    return found if isinstance(found, dict) else None


def main() -> int:
    """Run the node; returns the exit code (2: broken parameters)."""
    rospy.init_node("recorder")
    try:
        RecorderNode(read(Settings, rospy.get_param("~", {})))
    except ValueError as problem:
        print(f"recorder: {problem}", file=sys.stderr)
        return 2
    rospy.spin()
    return 0
