"""``check_frames`` as a node: moves one arm's tip along the camera's axes and judges the pictures.

Parameters: ``~cell`` (folder or cell.yaml), ``~arm`` (default: the first without an endoscope),
``~enable`` (false: the arm must be ENABLED and homed), ``~lockstep`` (false), ``~out`` (file of the
report in JSON; the pictures go beside it as NPZ). Exit code 0: hand and picture agree; 1: they do
not, or the check was not possible; 2: invalid cell or parameter.
"""

from __future__ import annotations

import json
import signal
import sys
import threading
import time
from typing import Any

import numpy as np
import rospy

from surg_core import ConfigError
from surg_msgs.msg import Cycle
from surg_ros.arm_port import ArmPort
from surg_ros.master_check import master_is_online
from surg_ros.params import ParamError
from surg_ros.participant import Participant, TickInputs
from surg_teleop.frames.check_task import CheckTask, read_task, report
from surg_teleop.frames.endoscope_pictures_node import EndoscopePictures, wait_for_eyes
from surg_teleop.frames.frame_check import FrameCheckStage, FramesCheck, split
from surg_teleop.frames.probe_moves import REST, WORDS
from surg_teleop.frames.registration_verdict import (
    ANGLE,
    CALIBRATED_ANGLE,
    Verdict,
    judge,
    not_seen,
)
from surg_teleop.frames.tip_tracker import NotSeen, Place, find_places
from surg_teleop.frames.undistortion import straighten
from surg_teleop.playback.workspace_fit import Workspace

CONNECT_TIMEOUT = 180.0
"""[s] Longest wait for controllers and pictures, wall clock."""
SILENCE = 0.5
"""[s] Timeout of an arm in free-run."""
PERIOD_TICKS = 5
"""Every fifth cycle is evaluated: 100 Hz."""
FLUSH = 0.3
"""[s] Wait after the last command, so that it leaves the socket."""


class CheckNode:
    """Wires a FramesCheck to an arm and the endoscope."""

    def __init__(self, task: CheckTask, eyes: tuple[str, ...]) -> None:
        self.task = task
        self.finished = threading.Event()
        arm = task.cell.arms[task.arm]
        limits = arm.limits
        workspace = Workspace(limits.depth_slow, limits.depth_max, limits.cone)
        self.check = FramesCheck(task.arm, rospy.get_name(), workspace, enable=task.enable)
        self.eyes = EndoscopePictures(eyes)
        self._lock = threading.RLock()
        self._port = ArmPort(task.arm)  # no claim; it would outlive the check
        self._heard: dict[str, float] = {}  # on the steady clock [s]
        self._announced = REST
        arms = (task.arm, task.camera.arm)
        self._participant = Participant(
            {task.arm: self._port},
            self._act,
            arms,
            lockstep=task.lockstep,
            listen=False,
            lock=self._lock,
        )
        keys: dict[str, Any] = {"queue_size": None, "tcp_nodelay": True}
        self._participant.inputs += [
            rospy.Subscriber(f"/{name}/cycle", Cycle, self._on_cycle, name, **keys) for name in arms
        ]
        self._participant.inputs += self.eyes.inputs

    def _on_cycle(self, cycle: Cycle, name: str) -> None:
        with self._lock:
            self._heard[name] = time.monotonic()
            self._participant.on_cycle(cycle, name)

    def _act(self, seen: TickInputs) -> bool | None:
        """Evaluate every fifth cycle of both arms; with the lock held."""
        if self.finished.is_set():
            return None
        if not self.check.done and seen.tick % PERIOD_TICKS == 0:
            self._look(seen)
        if self.check.done:
            self.finished.set()
        return self.check.done

    def _look(self, seen: TickInputs) -> None:
        scope = seen.cycles[self.task.camera.arm]
        if self.eyes.problem:
            self._port.send(self.check.stop(self.eyes.problem))
        else:
            q = np.array(scope.q)
            valid = q.shape == (self.task.camera.chain.dof,) and bool(np.isfinite(q).all())
            R_WV = self.task.camera.rotation(q) if valid else None
            R_WB = np.asarray(self.task.cell.arms[self.task.arm].X_WB)[:3, :3]
            view = seen.view(self.task.arm, R_WB)
            self._port.send(self.check.tick(view, R_WV, self.eyes.newest))
        self._announce()

    def _announce(self) -> None:
        """Print what the viewer must see now, once per step."""
        check = self.check
        if check.step != self._announced and check.stage is FrameCheckStage.GO and check.step.side:
            self._announced = check.step
            print(f"the tip must now go: {WORDS[check.step]}", flush=True)

    def check_silence(self) -> None:
        """End the check if an arm is silent in free-run, where nothing else would end it."""
        if self.task.lockstep:
            return
        with self._lock:
            oldest = min(self._heard, key=lambda name: self._heard[name])
            if time.monotonic() - self._heard[oldest] > SILENCE and not self.finished.is_set():
                reason = f"{oldest} is silent; check that its controller is running"
                self._port.send(self.check.stop(reason))
                self.finished.set()

    def stop(self, reason: str) -> None:
        """Abort the check; the arm holds."""
        with self._lock:
            self._port.send(self.check.stop(reason))

    def connect(self) -> None:
        """Wait for all connections; in lock-step then answer tick 1, which follows no cycle.

        Raises:
            TimeoutError: A connection is missing; states which.
            OSError: The master does not answer.
        """
        self._participant.connect(
            CONNECT_TIMEOUT,
            over=lambda: bool(rospy.is_shutdown() or self.finished.is_set()),
            also=self._mute,
        )

    def _mute(self) -> str:
        silent = "" if self.task.lockstep else ", ".join(self._participant.silent)
        return f"{silent} is silent; check that its controller is running" if silent else ""

    def verdict(self) -> tuple[Verdict, dict[str, Place]]:
        """Verdict, and the tip in the pictures by step."""
        lens = self.eyes.lens()
        if self.check.reason or lens is None:
            unknown = (
                "/endoscope/left/camera_info has not arrived, or its K is 0: measure the lens "
                "with ./surg calibrate CELL stereo"
            )
            return not_seen(self.check.reason or unknown), {}
        try:
            places = find_places(*split(self.check.pictures))
        except NotSeen as error:
            return not_seen(str(error)), {}
        straight = straighten(places, *self.eyes.eyes())
        limit = CALIBRATED_ANGLE if self.task.calibrated else ANGLE
        return judge(straight, lens, limit), {str(step): place for step, place in places.items()}


def main() -> int:
    """Run the node; returns the exit code."""
    if not master_is_online("check_frames"):
        return 1
    rospy.init_node("check_frames", disable_signals=True)
    try:
        task = read_task(dict(rospy.get_param("~", {})))
    except (ParamError, ConfigError) as error:
        print(f"{error}", file=sys.stderr)
        return 2
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    node: CheckNode | None = None
    try:
        camera = task.cell.arms[task.camera.arm].instrument.camera
        assert camera is not None  # read_task has found the arm by it
        node = CheckNode(task, wait_for_eyes(len(camera.frames), CONNECT_TIMEOUT))
        node.connect()
        while not node.finished.wait(0.05) and not ended.is_set() and not rospy.is_shutdown():
            node.check_silence()
    except (OSError, TimeoutError) as error:
        print(f"check_frames: {error}", file=sys.stderr)
        return 1
    finally:
        if node is not None:
            node.stop("it was interrupted")
            time.sleep(FLUSH)
    verdict, places = node.verdict()
    content = report(verdict, places, task)
    if task.out is not None:
        left, right = split(node.check.pictures)
        shown = {f"left_{step}": picture for step, picture in left.items()}
        shown |= {f"right_{step}": picture for step, picture in (right or {}).items()}
        np.savez_compressed(task.out.with_suffix(".npz"), **shown)
        task.out.write_text(json.dumps(content, indent=1) + "\n", "utf-8")
    print(f"{verdict.outcome.value}: {verdict.text}", flush=True)
    rospy.signal_shutdown("check_frames: done")
    return 0 if verdict.outcome.value == "pass" else 1
