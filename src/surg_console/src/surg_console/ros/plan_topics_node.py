"""Topics of what a policy plans and sees, for the page; subscribes to nothing until it asks."""

from __future__ import annotations

import json
import threading
import time
from typing import Any

import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo, JointState

import surg_core
from surg_console.session.plan_view import PlanView, planned_tips
from surg_core import ConfigError
from surg_core.pictures.camera_model import lens_of
from surg_core.pictures.eye_projection import EyeProjection
from surg_core.pictures.plan_projection import rcm_in_world
from surg_core.transforms import FloatArray
from surg_msgs.msg import Cycle, PolicyPlan
from surg_ros.byte_topics import BytesSubscriber
from surg_ros.joint_order import positions_of

PLAN, LENS = "/policy/plan", "/endoscope/left/camera_info"
FRESH = 1.0
"""[s] after which an arm is silent."""
SCOPE = "joints of the arm that holds the endoscope"
_MODEL = ("width", "height", "distortion_model", "D", "K", "R", "P")


class PlanTopics:
    """The newest plan, projected when a page asks for it: at most as often as plans come."""

    def __init__(self, cell: surg_core.Cell) -> None:
        self._cell, self._view = cell, PlanView(cell)
        self._lock = threading.Lock()
        self._plan: PolicyPlan | None = None
        self._text = ""
        self._eye: EyeProjection | None = None
        self._lens: tuple[Any, ...] = ()
        self._subscribers: list[rospy.Subscriber] = []
        self._polled: dict[str, BytesSubscriber] = {}
        self._newest: dict[str, tuple[float, bytes]] = {}

    def watch(self, wanted: bool) -> None:
        """Subscribe, or stop."""
        if wanted:
            keys: dict[str, Any] = {"queue_size": 1, "tcp_nodelay": True}
            self._subscribers = [
                rospy.Subscriber(PLAN, PolicyPlan, self._on_plan, **keys),
                rospy.Subscriber(LENS, CameraInfo, self._on_lens, **keys),
            ]
            topics = {name: (f"/{name}/cycle", Cycle) for name in self._cell.arms}
            if self._view.held is not None:
                topics[SCOPE] = (f"/{self._view.held.arm}/robot/measured_js", JointState)
            self._polled = {name: BytesSubscriber(*topic) for name, topic in topics.items()}
            return
        for subscriber in self._subscribers:
            subscriber.unregister()
        for polled in self._polled.values():
            polled.unregister()
        self._subscribers, self._polled, self._newest = [], {}, {}
        with self._lock:
            self._plan, self._text = None, ""

    def newest(self) -> str:
        """The newest plan as JSON; empty: there is none."""
        now = time.monotonic()
        for name, polled in self._polled.items():
            if messages := polled.fetch():
                self._newest[name] = (now, messages[-1])
        with self._lock:
            plan, self._plan = self._plan, None
            eye = self._eye
        if plan is not None:
            fresh = {n: data for n, (heard, data) in self._newest.items() if now - heard < FRESH}
            shown = self._view.as_json(plan, self._frames(plan, fresh), self._scope(fresh), eye)
            self._text = json.dumps(shown, allow_nan=False)
        return self._text

    def _frames(self, plan: PolicyPlan, fresh: dict[str, bytes]) -> dict[str, FloatArray]:
        """X_WR (4, 4) of the plan's arms that are heard."""
        frames = {}
        for name in planned_tips(plan):
            if name in fresh and name in self._cell.arms:
                cycle = Cycle().deserialize(fresh[name])
                X_WB = np.asarray(self._cell.arms[name].X_WB)
                frames[name] = rcm_in_world(X_WB, cycle.q_br, cycle.p_rcm)
        return frames

    def _scope(self, fresh: dict[str, bytes]) -> FloatArray | None:
        """Joints (n,) of the arm that holds the endoscope [rad]."""
        held = self._view.held
        if held is None or SCOPE not in fresh:
            return None
        wanted = [joint.name for joint in held.chain.joints]
        q = np.array(positions_of(JointState().deserialize(fresh[SCOPE]), wanted))
        return q if len(q) == len(wanted) else None

    def _on_plan(self, message: PolicyPlan) -> None:
        with self._lock:
            self._plan = message

    def _on_lens(self, info: CameraInfo) -> None:
        stated = tuple(getattr(info, key) for key in _MODEL)
        if stated == self._lens:
            return
        try:
            model = dict(zip(_MODEL, stated, strict=True))
            eye = EyeProjection(lens_of(LENS, "endoscope_left", model), np.eye(4))
        except ConfigError as error:
            rospy.logwarn("console: the plan has no place in the picture: %s", error)
            eye = None
        with self._lock:
            self._lens, self._eye = stated, eye
