"""The recorder node: topics in, one episode folder out.

Private parameters: ``recorder_parameters.Settings``.
"""

from __future__ import annotations

import sys
import threading

import rospy

from surg_recording.nodes.recorder_pacing_node import Pacing
from surg_recording.nodes.recorder_parameters import Settings
from surg_recording.nodes.recorder_state import RecorderState
from surg_recording.nodes.recorder_status_node import StatusPublisher
from surg_recording.nodes.recorder_topics_node import RecorderTopics, own_topics
from surg_recording.nodes.recording_switch_node import RecordingSwitch, recover_interrupted
from surg_recording.nodes.topic_discovery_node import TopicDiscovery
from surg_ros.params import read


def run(settings: Settings) -> None:
    """Record until shutdown."""
    state = RecorderState(settings, own_topics(settings.arms), _warn)
    status = StatusPublisher(state)
    switch = RecordingSwitch(state, status.announce)
    recover_interrupted(settings.out.parent, settings.out.name)
    if settings.autostart:
        switch.start()
    topics = RecorderTopics(state, switch)
    rospy.on_shutdown(switch.stop)
    Pacing(state, switch, status, topics.subscribers)
    TopicDiscovery(state, topics.subscribe_any)
    rospy.spin()


def _warn(text: str) -> None:
    """Log from another thread: callbacks wait for the caller, and a log may be slow."""
    threading.Thread(target=rospy.logwarn, args=(text,), daemon=True).start()


def main() -> int:
    """Run the node; returns the exit code (2: a parameter that cannot be used)."""
    rospy.init_node("recorder")
    try:
        settings = read(Settings, rospy.get_param("~", {}))
    except ValueError as problem:
        print(f"recorder: {problem}", file=sys.stderr)
        return 2
    run(settings)
    return 0
