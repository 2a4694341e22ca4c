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
from surg_recording.nodes.recorder_topics_node import COMMANDS, TASK_TOPIC, TRUTH_TOPIC
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
            return recording.written_tick()
        if recording is not self._failed:
            self._failed = recording
            threading.Thread(target=self._switch.stop, daemon=True).start()
        return state.tick  # a broken disk does not stop the simulation

    def _advertise_ready(self) -> rospy.Publisher:
        """Advertise /sim/ready once every topic to be recorded is connected.

        The simulator waits for this connection before its first tick, so no tick is missed.
        """
        arms = self._state.settings.arms
        needed = [f"/{arm}/cycle" for arm in arms]
        needed += [TRUTH_TOPIC, *self._state.settings.camera_topics.values()]
        commands = [f"/{arm}/{name}" for arm in arms for name in COMMANDS]
        complete_since = None
        while not rospy.is_shutdown():
            missing = [topic for topic in needed if not self._connected(topic)]
            if not missing and self._task_state_missing():
                missing = [TASK_TOPIC]
            if missing:
                rospy.loginfo_throttle(2, "recorder: waiting for %s", ", ".join(missing))
            else:
                complete_since = complete_since or time.monotonic()
                commanded = any(self._connected(topic) for topic in commands)
                if commanded or time.monotonic() - complete_since > 1.0:
                    break
            time.sleep(0.02)
        return rospy.Publisher("/sim/ready", Ready, queue_size=0, tcp_nodelay=True)

    def _connected(self, topic: str) -> bool:
        return self._subscribers[topic].get_num_connections() > 0

    def _task_state_missing(self) -> bool:
        """Whether a task's state is published but not connected yet.

        The simulator advertises it before ground truth, which is connected by now.
        """
        if self._connected(TASK_TOPIC):
            return False
        return any(topic == TASK_TOPIC for topic, _ in rospy.get_published_topics("/sim"))
