"""Topics of what a page shows over or beside the picture: marks, a plan, the arms in the room."""

from __future__ import annotations

import json
import math
import threading
import time
from typing import Any

import numpy as np
import rospy
from sensor_msgs.msg import JointState

import surg_core
from surg_console.ros.plan_topics_node import PlanTopics
from surg_console.session.scene_view import SceneView
from surg_core.transforms import FloatArray
from surg_msgs.msg import PictureMarks
from surg_ros.byte_topics import BytesSubscriber
from surg_ros.joint_order import positions_of

MARKS = "/endoscope/marks"
FRESH = 1.0
"""[s] after which an arm is silent."""


class OverlayTopics:
    """See `RunningSystem`. Subscribes to nothing until a page asks."""

    def __init__(self, cell: surg_core.Cell) -> None:
        self._scene, self._plan = SceneView(cell), PlanTopics(cell)
        self._lock = threading.Lock()
        self._marks = ""
        self._marks_topic: rospy.Subscriber | None = None
        self._joints: dict[str, BytesSubscriber] = {}
        self._newest: dict[str, tuple[float, FloatArray]] = {}

    def watch(self, what: str, wanted: bool) -> None:
        """Subscribe, or stop."""
        if what == "marks":
            self._watch_marks(wanted)
        elif what == "plan":
            self._plan.watch(wanted)
        elif wanted:
            topics = {name: f"/{name}/robot/measured_js" for name in self._scene.joints}
            self._joints = {n: BytesSubscriber(t, JointState) for n, t in topics.items()}
        else:
            for polled in self._joints.values():
                polled.unregister()
            self._joints, self._newest = {}, {}

    def _watch_marks(self, wanted: bool) -> None:
        if wanted:
            self._marks_topic = rospy.Subscriber(
                MARKS, PictureMarks, self._on_marks, queue_size=1, tcp_nodelay=True
            )
        elif self._marks_topic is not None:
            self._marks_topic.unregister()
            self._marks_topic = None
            with self._lock:
                self._marks = ""

    def overlay(self, what: str) -> str:
        """The newest as JSON; empty: there is none."""
        if what == "scene":
            return self._scene_now()
        if what == "plan":
            return self._plan.newest()
        with self._lock:
            return self._marks

    def _on_marks(self, message: PictureMarks) -> None:
        text = json.dumps(marks_as_json(message), allow_nan=False)
        with self._lock:
            self._marks = text

    def _scene_now(self) -> str:
        for name, polled in self._joints.items():
            messages = polled.fetch()
            if messages:
                wanted = self._scene.joints[name]
                q = np.array(positions_of(JointState().deserialize(messages[-1]), wanted))
                if len(q) == len(wanted):
                    self._newest[name] = (time.monotonic(), q)
        now = time.monotonic()
        fresh = {name: q for name, (heard, q) in self._newest.items() if now - heard < FRESH}
        return json.dumps(self._scene.as_json(fresh), allow_nan=False)


def marks_as_json(message: Any) -> dict[str, Any]:
    """A PictureMarks as a page draws it; points that are not before the eye are null."""
    marks = []
    for mark in message.marks:
        points = zip(mark.x, mark.y, strict=False)
        known = [[x, y] if math.isfinite(x) and math.isfinite(y) else None for x, y in points]
        ellipse = [v for v in mark.ellipse if math.isfinite(v)]
        marks.append(
            {
                "arm": mark.arm,
                "name": mark.name,
                "eye": mark.eye,
                "points": known,
                "ellipse": ellipse if len(ellipse) == 3 else None,
            }
        )
    return {
        "say": "marks",
        "exposed_us": message.header.stamp.to_nsec() // 1000,
        "width": message.width,
        "height": message.height,
        "marks": marks,
    }
