"""Publishes /record/status and /record/recording."""

from __future__ import annotations

import time

import rospy
from std_msgs.msg import Bool

from surg_msgs.msg import RecordStatus
from surg_recording.episode.episode_recorder import Recording
from surg_recording.nodes.recorder_state import RecorderState
from surg_recording.nodes.status_messages_node import describe_recording


class StatusPublisher:
    """Reports the recorder's state to other nodes."""

    def __init__(self, state: RecorderState) -> None:
        self._state = state
        self._status = rospy.Publisher("/record/status", RecordStatus, queue_size=10, latch=True)
        self._flag = rospy.Publisher("/record/recording", Bool, queue_size=10, latch=True)
        self._flag.publish(False)

    def announce(self) -> None:
        """Publish a change; the status goes first, so that it explains the flag."""
        self.publish()
        self._flag.publish(self._state.recording is not None)

    def publish(self) -> None:
        """Publish the status."""
        state, recording = self._state, self._state.recording
        activity = RecordStatus.STATE_IDLE if recording is None else RecordStatus.STATE_RECORDING
        message = RecordStatus(
            version=RecordStatus.VERSION,
            state=RecordStatus.STATE_FINISHING if state.finishing else activity,
            problem=self._problem_code(recording),
            detail=state.problem or "",
            starts=state.starts,
            tick=state.tick,
            finished=state.finished or "",
            warnings=state.warnings,
        )
        message.header.stamp = rospy.Time(*divmod(time.time_ns(), 10**9))
        if recording is not None:
            describe_recording(message, recording, state.waiting_for(recording))
            message.detail = recording.problem or ""
        self._status.publish(message)

    def _problem_code(self, recording: Recording | None) -> int:
        problem = self._state.problem if recording is None else recording.problem
        if not problem:
            return RecordStatus.PROBLEM_NONE
        if recording is None and not self._state.started:
            return RecordStatus.PROBLEM_NOT_STARTED
        return RecordStatus.PROBLEM_INCOMPLETE
