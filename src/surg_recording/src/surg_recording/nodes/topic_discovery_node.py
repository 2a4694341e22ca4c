"""Finds topics that appear later and match a pattern; warns of requested topics that are silent."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import rospy

from surg_recording.nodes import ros_master_node
from surg_recording.nodes.recorder_state import RecorderState

PERIOD_S = 1.0
SILENT_S = 5.0
"""A requested topic is reported when it has sent nothing for this long [s]."""


class TopicDiscovery:
    """One thread that queries the ROS master once a second; ``subscribe`` records a topic."""

    def __init__(self, state: RecorderState, subscribe: Callable[[str], None]) -> None:
        self._state, self._subscribe = state, subscribe
        self._master_lost = False
        threading.Thread(target=self._run, name="discover", daemon=True).start()

    def _run(self) -> None:
        reported: set[str] = set()
        quiet_since = time.monotonic()
        while not rospy.is_shutdown():
            published = self._published()
            for topic in self._state.choice.newly_chosen(published):
                self._subscribe(topic)
            recording = self._state.recording
            if recording is None:
                reported, quiet_since = set(), time.monotonic()
            elif time.monotonic() - quiet_since > SILENT_S:
                for topic in sorted(set(self._state.waiting_for(recording)) - reported):
                    reported.add(topic)
                    # Refusals, for one, are published by somebody and silent while all is well.
                    tell = rospy.loginfo if topic in published else rospy.logwarn
                    tell("recorder: nothing has come on %s yet", topic)
            time.sleep(PERIOD_S)

    def _published(self) -> dict[str, str]:
        try:
            published = ros_master_node.published_topics()
        except ros_master_node.ERRORS as problem:
            if not self._master_lost:
                rospy.logwarn(
                    "recorder: the ROS master does not answer (%s). Connected topics are still "
                    "recorded; new topics are not found.",
                    problem,
                )
            self._master_lost = True
            return {}
        self._master_lost = False
        return published
