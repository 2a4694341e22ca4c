"""Paces the simulator in lock-step, and watches disk and cameras."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping

import rospy

from surg_msgs.msg import Ready
from surg_recording.episode.episode_recorder import Recording
from surg_recording.nodes.recorder_state import RecorderState
from surg_recording.nodes.recorder_status_node import StatusPublisher
from surg_recording.nodes.recorder_topics_node import (
    ASSISTANT_TOPIC,
    TASK_TOPIC,
    TRUTH_TOPIC,
)
from surg_recording.nodes.recording_switch_node import RecordingSwitch

PERIOD_S = 0.01
READY_TICKS = 25
"""Ready is sent every so many ticks, and at the latest 5 periods after the last one."""
STATUS_S = 0.2
"""Period of /record/status [s]."""


class Pacing:
    """One thread: acknowledges written ticks, publishes the status, ends a failed recording.

    The simulator runs ahead of an acknowledged tick by a window only. A slow disk therefore slows
    the simulation down instead of losing rows. ``subscribers`` by topic must be connected first.
    """

    def __init__(
        self,
        state: RecorderState,
        switch: RecordingSwitch,
        status: StatusPublisher,
        subscribers: Mapping[str, rospy.Subscriber],
    ) -> None:
        self._state, self._switch, self._status = state, switch, status
        self._subscribers = subscribers
        self._failed: Recording | None = None
        threading.Thread(target=self._run, name="pace", daemon=True).start()

    def _run(self) -> None:
        ready = self._advertise_ready() if self._state.lockstep else None
        sent = 0
        sent_at = status_at = time.monotonic()
        while not rospy.is_shutdown():
            time.sleep(PERIOD_S)
            now = time.monotonic()
            tick = self._written_tick(now)
            due = tick >= sent + READY_TICKS or (tick > sent and now - sent_at > 5 * PERIOD_S)
            if ready is not None and due:
                ready.publish(Ready(tick=tick, participant="recorder"))
                sent, sent_at = tick, now
            if now - status_at > STATUS_S:
                status_at = now
                self._status.publish()

    def _written_tick(self, now: float) -> int:
        """Newest tick that can be acknowledged; looks after disk and cameras on the way."""
        state, recording = self._state, self._state.recording
        wall = state.clock.now_ns()  # also detects a clock step while no message arrives
        if recording is None:
            return state.tick
        recording.watch_cameras(now, wall)
        if not recording.failed:
            return recording.tables.written_tick(recording.arms)
        if recording is not self._failed:
            self._failed = recording
            threading.Thread(target=self._switch.stop, daemon=True).start()
        return state.tick  # a broken disk does not stop the simulation

    def _advertise_ready(self) -> rospy.Publisher:
        """Advertise /sim/ready once every topic to be recorded is connected.

        The simulator waits for this connection before its first tick, so no tick is missed.
        """
        arms = self._state.settings.arms
        needed = [f"/{arm}/{topic}" for arm in arms for topic in ("cycle", "received")]
        needed += [TRUTH_TOPIC, *self._state.settings.camera_topics.values()]
        while not rospy.is_shutdown():
            missing = [topic for topic in needed if not self._connected(topic)]
            missing = missing or self._task_topics_missing()
            if not missing:
                break
            rospy.loginfo_throttle(2, "recorder: waiting for %s", ", ".join(missing))
            time.sleep(0.02)
        return rospy.Publisher("/sim/ready", Ready, queue_size=0, tcp_nodelay=True)

    def _connected(self, topic: str) -> bool:
        return self._subscribers[topic].get_num_connections() > 0

    def _task_topics_missing(self) -> list[str]:
        """What the simulator publishes for a task and is not connected yet.

        It advertises that before ground truth, which is connected by now.
        """
        waiting = [t for t in (TASK_TOPIC, ASSISTANT_TOPIC) if not self._connected(t)]
        published = {topic for topic, _ in rospy.get_published_topics()} if waiting else set()
        return [topic for topic in waiting if topic in published]
