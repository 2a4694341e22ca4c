"""The recorder's subscriptions: every message goes into the running recording."""

from __future__ import annotations

import functools
import json
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import rospy
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Bool, String

from crtk_msgs.msg import OperatingState, StringStamped
from surg_core.force.observed_force import TOPICS
from surg_core.status_check import LatestStatus, fault
from surg_msgs.msg import (
    ClockSync,
    Cycle,
    DriftStatus,
    GroundTruth,
    ReceivedCommand,
    SimStatus,
    TaskState,
)
from surg_recording.calibration.endoscope_record import camera_info_topic, camera_model
from surg_recording.episode import table_rows
from surg_recording.episode.annotations import parse_info, parse_tag
from surg_recording.episode.episode_recorder import Recording
from surg_recording.episode.message_fields import Flat
from surg_recording.episode.topic_selection import IMAGES, NOT_TABLES
from surg_recording.nodes.message_decoder_node import class_of, get_message_class, sender
from surg_recording.nodes.recorder_state import RecorderState
from surg_recording.nodes.recording_switch_node import RecordingSwitch
from surg_recording.nodes.status_messages_node import simulation_outcome
from surg_ros.arm_port import MOTION_COMMANDS, OTHER_COMMANDS
from surg_ros.byte_topics import Pause

ASSISTANT = "assistant"
HOLD = "hold"
TEXTS = ("error", "warning", "status")
"""Text topics of an arm that go to ``events.csv``."""
GATHER_S = 0.02
"""[s] Lock-step: so long messages of a tick may wait for the recorder, which may be late there."""
TRUTH_TOPIC = "/sim/ground_truth/state"
TASK_TOPIC = "/sim/task_state"
DRIFT_TOPIC = "/endoscope/drift"
CLOCK_TOPIC = "/clock_sync/status"
ASSISTANT_TOPIC = f"/{ASSISTANT}/received"


def own_topics(arms: Sequence[str]) -> list[str]:
    """Topics that have a table of their own."""
    names = [
        *(*MOTION_COMMANDS, HOLD),
        *TOPICS.values(),
        "cycle",
        "received",
        "operating_state",
        "tool/mounted",
        *TEXTS,
    ]
    return [
        *(f"/{arm}/{name}" for arm in arms for name in names),
        *(f"/{ASSISTANT}/{name}" for name in ("servo_jp", "jaw/servo_jp")),
        *(TRUTH_TOPIC, TASK_TOPIC, ASSISTANT_TOPIC, "/sim/status", CLOCK_TOPIC, DRIFT_TOPIC),
        *("/record/record", "/record/tag", "/record/info"),
    ]


class RecorderTopics:
    """Subscribes to everything that is recorded; ``subscribers`` by topic."""

    def __init__(self, state: RecorderState, switch: RecordingSwitch) -> None:
        self._state, self._switch = state, switch
        self._clock = state.clock
        self._sim = LatestStatus("/sim/status")
        self._drift: tuple[int, str] | None = None
        self.subscribers: dict[str, rospy.Subscriber] = {}
        for arm in state.settings.arms:
            self._subscribe_arm(arm)
        for arm in (*state.settings.arms, ASSISTANT):
            self._subscribe(f"/{arm}/received", ReceivedCommand, self._on_received, arm)
        self._subscribe(TRUTH_TOPIC, GroundTruth, self._on_truth)
        self._subscribe(TASK_TOPIC, TaskState, self._on_task_state)
        self._subscribe("/sim/status", SimStatus, self._on_sim_status)
        self._subscribe(DRIFT_TOPIC, DriftStatus, self._on_drift)
        for camera, topic in state.settings.camera_topics.items():
            self._subscribe(topic, rospy.AnyMsg, self._on_image, camera)
            model = camera_info_topic(topic)
            if model not in state.choice.chosen:
                self._subscribe(model, CameraInfo, self._on_camera_info, camera)
        self._subscribe(CLOCK_TOPIC, ClockSync, self._on_clock_sync)
        self._subscribe("/record/record", Bool, self._on_record)
        self._subscribe("/record/tag", String, self._on_tag)
        self._subscribe("/record/info", String, self._on_info)
        for topic in state.choice.named:
            if topic in state.choice.chosen:
                self.subscribe_any(topic)

    def subscribe_any(self, topic: str) -> None:
        """Record a topic of any type; a command to an arm comes by ``received``."""
        _, arm, name = (*topic.split("/", 2), "")[:3]
        if arm not in self._state.settings.arms or name not in OTHER_COMMANDS:
            self._subscribe(topic, rospy.AnyMsg, self._on_any, topic)

    def _subscribe_arm(self, arm: str) -> None:
        self._subscribe(f"/{arm}/cycle", Cycle, self._on_cycle, arm)
        for place, topic in TOPICS.items():
            self._subscribe(f"/{arm}/{topic}", WrenchStamped, self._on_force, arm, place)
        self._subscribe(f"/{arm}/tool/mounted", StringStamped, self._on_tool, arm)
        self._subscribe(f"/{arm}/operating_state", OperatingState, self._on_operating_state, arm)
        for name in TEXTS:
            self._subscribe(f"/{arm}/{name}", String, self._on_text, f"/{arm}/{name}")

    def _subscribe(self, topic: str, kind: type, call: Callable[..., None], *args: Any) -> None:
        take = functools.partial(call, *args)
        frequent = call in (self._on_cycle, self._on_truth, self._on_force)
        pause = Pause(GATHER_S if frequent and self._state.lockstep else 0.0)

        def receive(message: Any) -> None:
            take(message)
            pause()

        self.subscribers[topic] = rospy.Subscriber(
            topic,
            kind,
            receive,
            queue_size=None,
            buff_size=1 << 20 if call == self._on_image else 1 << 16,
            tcp_nodelay=True,
        )

    def _is_new(self, topic: str, message: Any, key: Any = None) -> bool:
        """Whether no other connection has delivered this message before."""
        if key is None:
            key = message.header.seq, table_rows.nanoseconds(message.header.stamp)
        return not self._state.is_duplicate(topic, message._connection_header, key)

    def _recording_of(self, topic: str, message: Any) -> Recording | None:
        """The running recording, unless it has the message already."""
        recording = self._state.recording
        return recording if recording is not None and self._is_new(topic, message) else None

    def _recording_of_state(self, topic: str, message: Any) -> Recording | None:
        """The running recording, unless it has the state of this tick already."""
        recording = self._recording_of(topic, message)
        return None if recording and self._state.is_repeated(topic, message.tick) else recording

    # --- tables -------------------------------------------------------------------------------

    def _on_cycle(self, arm: str, message: Cycle) -> None:
        if recording := self._recording_of(f"/{arm}/cycle", message):
            recording.cycle(arm, message, self._clock.now_ns())
        self._state.received(f"cycle_{arm}", message.tick)

    def _on_truth(self, message: GroundTruth) -> None:
        if recording := self._recording_of_state(TRUTH_TOPIC, message):
            recording.ground_truth(message, self._clock.now_ns())
        for arm in message.arms:
            self._state.received(f"ground_truth_{arm.arm}", message.tick)

    def _on_force(self, arm: str, place: str, message: WrenchStamped) -> None:
        if recording := self._recording_of(f"/{arm}/{TOPICS[place]}", message):
            recording.force(arm, place, message, self._clock.now_ns())

    def _on_task_state(self, message: TaskState) -> None:
        if recording := self._recording_of_state(TASK_TOPIC, message):
            recording.task_state(message, self._clock.now_ns())
        self._state.last_row = time.monotonic()

    def _on_received(self, arm: str, message: ReceivedCommand) -> None:
        recording = self._recording_of(f"/{arm}/received", message)
        topic, received = f"/{arm}/{message.topic}", table_rows.nanoseconds(message.header.stamp)
        if recording is None:
            return
        if message.topic == HOLD:
            recording.event(topic, message.sender, "", received)
        elif message.topic in MOTION_COMMANDS or topic in self._state.choice.chosen:
            command = _decoded(recording, topic, get_message_class(message.type), message.data)
            if command is None:
                return
            if message.topic in MOTION_COMMANDS:
                recording.command(arm, message.topic, command, message.sender, received)
            else:
                recording.topic(topic, message.type, Flat(command), message.sender, received)

    def _on_clock_sync(self, message: ClockSync) -> None:
        if recording := self._recording_of(CLOCK_TOPIC, message):
            recording.clock_sync(message, self._clock.now_ns())

    # --- events -------------------------------------------------------------------------------

    def _on_operating_state(self, arm: str, message: OperatingState) -> None:
        topic, text = f"/{arm}/operating_state", table_rows.operating_state(message)
        is_new = self._is_new(topic, message)
        if text != self._state.operating_states.get(arm) and is_new:
            self._state.operating_states[arm] = text
            stamp = table_rows.nanoseconds(message.header.stamp)
            self._state.event(topic, sender(message), text, stamp)

    def _on_tool(self, arm: str, message: StringStamped) -> None:
        topic = f"/{arm}/tool/mounted"
        if not self._is_new(topic, message) or message.string == self._state.mounted.get(arm):
            return
        self._state.event(topic, sender(message), message.string)
        # Ending a recording waits for messages in transit, which this thread may have to take.
        threading.Thread(target=self._switch.tool_mounted, args=(arm, message.string)).start()

    def _on_text(self, topic: str, message: String) -> None:
        if self._is_new(topic, message, message.data):
            self._state.event(topic, sender(message), message.data)

    def _on_sim_status(self, message: SimStatus) -> None:
        now = time.monotonic()
        self._sim.take(message, now)
        if complaint := self._sim.complaint(now):
            rospy.logwarn("recorder: not in the manifest: %s", complaint)
        if self._sim.at(now) is None:
            return
        before, outcome = self._state.sim_outcome, simulation_outcome(message)
        self._state.sim_outcome = outcome
        ended = message.state != SimStatus.STATE_RUNNING
        if ended and not (before.get("done") or before.get("aborted")):
            self._state.event("/sim/status", sender(message), json.dumps(outcome))

    def _on_drift(self, message: DriftStatus) -> None:
        """The watch over the picture: changes are events; what it refuses is in the manifest."""
        if fault(message):
            return
        before, self._drift = self._drift, (message.state, message.cause)
        if self._drift != before and self._is_new(DRIFT_TOPIC, message):
            stamp = table_rows.nanoseconds(message.header.stamp)
            self._state.event(DRIFT_TOPIC, sender(message), message.detail, stamp)
        if message.refusal:
            since = table_rows.nanoseconds(message.since)
            self._state.drift = {"since_ns": since, "cause": message.cause, "text": message.refusal}

    # --- topics of any type -------------------------------------------------------------------

    def _on_image(self, camera: str, message: Any) -> None:
        """A raw or compressed picture: its sender chooses the type."""
        recording = self._state.recording
        if recording is None:
            return
        received, topic = self._clock.now_ns(), self._state.settings.camera_topics[camera]
        kind, why = class_of(message, IMAGES)
        if why is not None:
            recording.warn(f"{topic}: not recorded as a camera: {why}")
        elif (image := _decoded(recording, topic, kind, message._buff)) is not None:
            header = (image.header.seq, table_rows.nanoseconds(image.header.stamp))
            if self._is_new(topic, message, header):
                recording.image(camera, image, received)

    def _on_camera_info(self, camera: str, message: CameraInfo) -> None:
        """The model of a camera; a recording through two lenses says so."""
        model, before = camera_model(message), self._state.camera_models.get(camera)
        if before not in (None, model) and (recording := self._state.recording) is not None:
            recording.warn(f"{camera}: camera_info has changed; the manifest states the last one")
        self._state.camera_models[camera] = model

    def _on_any(self, topic: str, message: Any) -> None:
        recording = self._state.recording
        if recording is None or not self._is_new(topic, message, message._buff):
            return
        received = self._clock.now_ns()
        type_name = str(message._connection_header.get("type", ""))
        kind, why = class_of(message)
        why = NOT_TABLES.get(type_name, why)
        if why is not None:
            if self._state.choice.refuse(topic, why):
                rospy.logwarn("recorder: %s is not recorded: %s", topic, why)
        elif (decoded := _decoded(recording, topic, kind, message._buff)) is not None:
            recording.topic(topic, type_name, Flat(decoded), sender(message), received)

    # --- commands to the recorder -------------------------------------------------------------

    def _on_record(self, message: Bool) -> None:
        action = self._switch.start if message.data else self._switch.stop
        threading.Thread(target=action, daemon=True).start()

    def _on_tag(self, message: String) -> None:
        recording, source = self._state.recording, sender(message)
        if not self._is_new("/record/tag", message, message.data):
            return
        if recording is None:
            rospy.logwarn("recorder: a tag while nothing is recorded: %s", message.data[:200])
            return
        try:
            tag = parse_tag(message.data)
        except ValueError as problem:
            rospy.logwarn("recorder: %s", problem)
            return
        now = self._clock.now_ns()
        recording.tag(tag, message.data, source, now, self._state.episode_now(now))

    def _on_info(self, message: String) -> None:
        try:
            info = parse_info(message.data)
        except ValueError as problem:
            rospy.logwarn("recorder: %s", problem)
            return
        self._state.run_info = {**self._state.run_info, **info}


def _decoded(recording: Recording, topic: str, kind: Any, data: bytes) -> Any | None:
    """The message as its class; None and a warning for malformed bytes."""
    try:
        return kind().deserialize(data)
    except Exception as problem:  # genpy raises many kinds of errors on malformed bytes
        name = type(problem).__name__
        recording.warn(f"{topic}: a message that is no {kind._type} ({name})")
        return None
