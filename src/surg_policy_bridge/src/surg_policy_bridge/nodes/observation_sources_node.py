"""Sources of an observation: arm states, forces, camera pictures, the task's ground truth."""

from __future__ import annotations

import time
import zlib
from collections.abc import Mapping, Sequence

import numpy as np
import rospy
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import Image

import surg_core
from surg_core.arm_view import ArmView
from surg_core.contract import FORCE_KEY, SECOND_NS, STATE_KEY, TASK_STATE_KEY, image_key
from surg_msgs.msg import TaskState
from surg_policy_bridge.server import cell_spec
from surg_policy_bridge.server.observer import TOLERANCE, CameraWatch, Observer, lagging_arm
from surg_policy_bridge.server.policy_arm import rcm_frame
from surg_policy_bridge.server.served_forces import ServedForces
from surg_policy_bridge.server.server_parameters import Settings
from surg_policy_bridge.server.timers import CAMERA_PERIODS
from surg_policy_client.observation import RCM as RCM_KEY
from surg_policy_client.spec import Spec

ENCODINGS = {"rgb8": slice(None), "bgr8": slice(None, None, -1)}
"""Allowed image encodings, with the order of their channels."""


class ObservationSources:
    """Collects the newest values of all sources and supervises the cameras.

    ``observer`` assembles the observations; ``image_keys`` are those of the cameras.
    """

    def __init__(self, settings: Settings, cell: surg_core.Cell) -> None:
        self._settings, self._cell = settings, cell
        self.image_keys = [image_key(camera) for camera in settings.cameras]
        keys = [
            STATE_KEY,
            RCM_KEY,
            *self.image_keys,
            *([TASK_STATE_KEY] if settings.privileged else []),
        ]
        keys += [FORCE_KEY] if settings.forces else []
        period = round(SECOND_NS / settings.camera_rate)
        tolerance = max(TOLERANCE, CAMERA_PERIODS * period if settings.cameras else 0)
        self.observer = Observer(keys, 0 if settings.lockstep else tolerance)
        self._watches = {name: CameraWatch(name, period) for name in settings.cameras}
        # Rendered pictures have no noise, so they repeat while nothing moves.
        self._rendered = all(cell.arms[name].link == "simulator" for name in settings.arms)
        self._sizes: dict[str, tuple[int, int]] = {}
        self._task_names: list[str] | None = None
        self._forces = ServedForces(settings.arms)
        self._homed = False

    def add_image(self, message: Image, camera: str) -> None:
        """Take in a picture; one that cannot be served is dropped with a warning."""
        order = ENCODINGS.get(message.encoding)
        size = (message.height, message.width)
        if order is None or message.step != 3 * message.width:
            problem = f"encoding {message.encoding}; allowed: {', '.join(ENCODINGS)}, packed rows"
        else:
            problem = cell_spec.too_large(*size)
        if problem:
            rospy.logwarn_throttle(5.0, f"{camera}: {problem}")
            return
        stamp_ns, checksum = message.header.stamp.to_nsec(), zlib.crc32(message.data)
        self._watches[camera].picture(time.monotonic_ns(), stamp_ns, checksum)
        if self._sizes.setdefault(camera, size) != size:
            rospy.logwarn_throttle(5.0, f"{camera}: size {size}; expected {self._sizes[camera]}")
            return
        pixels = np.frombuffer(message.data, np.uint8).reshape(*size, 3)[:, :, order]
        self.observer.put(image_key(camera), stamp_ns, np.ascontiguousarray(pixels))

    def add_force(self, message: WrenchStamped, arm: str, place: str) -> None:
        """Take in what a sensor says of an arm's tip or trocar; stamp 0: it does not know."""
        f = message.wrench.force
        self._forces.take(arm, place, message.header.stamp.to_nsec(), np.array([f.x, f.y, f.z]))

    def forces_behind(self, at_ns: int, expected: Mapping[str, Sequence[str]]) -> bool:
        """Lock-step: whether a force of an observation at that time [ns] has not arrived yet."""
        return self._settings.forces and self._forces.behind(at_ns, expected)

    def add_task_state(self, state: TaskState) -> None:
        """Take in the ground truth of a grid time."""
        values = np.array(state.values, dtype="<f4")
        self.observer.put(TASK_STATE_KEY, state.header.stamp.to_nsec(), values)
        if self._task_names is None:
            self._task_names = cell_spec.task_numbers(state.names)

    def add_arms(self, views: Mapping[str, ArmView]) -> tuple[int | None, str]:
        """Take in the state of all arms.

        Returns the stamp of the youngest state [ns], or None and why there is no observation.
        """
        arms = self._settings.arms
        if len(views) < len(arms):
            return None, "an arm is silent"
        if lagging := lagging_arm({arm: view.stamp_ns for arm, view in views.items()}):
            return None, lagging
        numbers = np.array([n for arm in arms for n in views[arm].numbers], dtype="<f4")
        if not np.isfinite(numbers).all():
            return None, "an arm does not know its jaw"
        stamp_ns = max(view.stamp_ns for view in views.values())
        self.observer.put(STATE_KEY, stamp_ns, numbers)
        bases = [np.asarray(self._cell.arms[arm].X_WB) for arm in arms]
        frames = [rcm_frame(views[arm], base) for arm, base in zip(arms, bases, strict=True)]
        self.observer.put(RCM_KEY, stamp_ns, np.array(frames, dtype="<f8"))
        if self._settings.forces:
            self.observer.put(FORCE_KEY, stamp_ns, self._forces.row(views, stamp_ns))
        return stamp_ns, ""

    def spec(self) -> Spec | None:
        """Specification of the observations; None until every source has sent."""
        settings = self._settings
        if len(self._sizes) < len(settings.cameras):
            return None
        if settings.privileged and self._task_names is None:
            return None
        if settings.forces and self._forces.silent:
            return None
        sizes = {name: self._sizes[name] for name in settings.cameras}
        return cell_spec.make(
            self._cell, settings.arms, settings.task, sizes, self._task_names, settings.forces
        )

    def camera_problem(self, now: int, views: Mapping[str, ArmView]) -> str:
        """Which camera no policy may use now; empty: none. ``now`` on the steady clock [ns]."""
        tips = None
        if self._rendered and views:
            tips = np.concatenate([view.p_tip for view in views.values()])
        before, self._homed = self._homed, all(view.homed for view in views.values())
        for watch in self._watches.values():
            if not (before and self._homed):  # homing changes the frame of the tips
                watch.forget_tips()
            if problem := watch.problem(now, tips):
                return problem
        return ""
