"""``check_frames`` as a node: moves one arm's tip along the camera's axes and judges the pictures.

Parameters: ``~cell`` (folder or cell.yaml), ``~arm`` (the first that holds no endoscope),
``~enable`` (false: the arm must be ENABLED and homed already), ``~lockstep`` (false), ``~out``
(file of the verdict in JSON; beside it the pictures as NPZ). Exit code 0: hand and picture agree;
1: they do not, or it could not be told; 2: a cell or parameter that must not be used.
"""

from __future__ import annotations

import json
import math
import signal
import sys
import threading
import time
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rosgraph
import rospy
from sensor_msgs.msg import CameraInfo, Image

import surg_core
from surg_core import ConfigError
from surg_core.arm_view import ArmCommands
from surg_ros.arm_port import ArmPort
from surg_ros.params import ParamError, flag, path, read, text
from surg_ros.participant import Participant, Seen
from surg_ros.peers import publishers
from surg_ros.transport.raw_message import RawCycle
from surg_teleop.follow.endoscope_pose import HeldCamera, held_camera
from surg_teleop.frames.frame_check import FramesCheck, Pair, Stage, split
from surg_teleop.frames.probe_moves import REST, WORDS
from surg_teleop.frames.registration_verdict import Lens, Verdict, judge, not_seen
from surg_teleop.frames.tip_tracker import NotSeen, Picture, Place, find_places
from surg_teleop.playback.workspace_fit import Workspace

CONNECT_TIMEOUT = 180.0
"""[s] wall clock: longest wait for controllers and pictures."""
SILENCE = 0.5
"""[s] Free-run: an arm that has said nothing for longer is not there."""
PERIOD_TICKS = 5
"""Every fifth cycle is looked at and answered: 100 Hz."""
FLUSH = 0.3
"""[s] After the last command, so that it leaves the socket."""
EYES = ("left", "right")
KEPT = 8
"""Pictures of an eye that wait for their other half."""


@dataclass(frozen=True)
class Task:
    """What the parameters describe."""

    cell: surg_core.Cell
    arm: str
    camera: HeldCamera
    enable: bool
    lockstep: bool
    out: Path | None


class Eyes:
    """Pictures of one or two cameras, put together by their stamps.

    Args:
        names: Of the eyes that there are.
    """

    def __init__(self, names: tuple[str, ...]) -> None:
        self.names = names
        self.newest: Pair | None = None
        self.problem = ""
        self._waiting: dict[str, OrderedDict[int, Picture]] = {n: OrderedDict() for n in names}
        self._infos: dict[str, CameraInfo] = {}
        self.inputs = []
        for name in names:
            root = f"/endoscope/{name}"
            keys: dict[str, Any] = {"tcp_nodelay": True, "buff_size": 1 << 24}
            self.inputs += [
                rospy.Subscriber(f"{root}/image_raw", Image, self._on_image, name, **keys),
                rospy.Subscriber(f"{root}/camera_info", CameraInfo, self._on_info, name, **keys),
            ]

    def _on_info(self, message: CameraInfo, name: str) -> None:
        self._infos[name] = message

    def _on_image(self, message: Image, name: str) -> None:
        picture = decode(message)
        if picture is None:
            self.problem = (
                f"/endoscope/{name}/image_raw has encoding '{message.encoding}'; allowed are rgb8 "
                "and bgr8"
            )
            return
        waiting = self._waiting[name]
        waiting[message.header.stamp.to_nsec()] = picture
        while len(waiting) > KEPT:
            waiting.popitem(last=False)
        stamps = set.intersection(*(set(w) for w in self._waiting.values()))
        if stamps:
            stamp = max(stamps)
            pictures = [self._waiting[n][stamp] for n in self.names]
            self.newest = Pair(stamp, pictures[0], pictures[1] if len(pictures) > 1 else None)

    def lens(self) -> Lens | None:
        """The cameras' model; None: it has not been said yet."""
        if set(self._infos) != set(self.names):
            return None
        left = self._infos["left"]
        baseline = 0.0
        if "right" in self._infos:
            P = self._infos["right"].P
            baseline = abs(P[3] / P[0]) if P[0] else 0.0
        return Lens(left.K[0], np.array([left.K[2], left.K[5]]), baseline)


def decode(message: Image) -> Picture | None:
    """(h, w, 3) rgb8 of a message; None: another encoding."""
    if message.encoding not in ("rgb8", "bgr8"):
        return None
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
    picture = rows[:, : 3 * message.width].reshape(message.height, message.width, 3)
    return picture if message.encoding == "rgb8" else picture[..., ::-1]


class CheckNode:
    """Wires a FramesCheck to an arm and the endoscope.

    Args:
        task: What to check.
        eyes: Names of the eyes that there are.
    """

    def __init__(self, task: Task, eyes: tuple[str, ...]) -> None:
        self.task = task
        self.finished = threading.Event()
        arm = task.cell.arms[task.arm]
        limits = arm.limits
        workspace = Workspace(limits.depth_slow, limits.depth_max, limits.cone)
        self.check = FramesCheck(task.arm, rospy.get_name(), workspace, enable=task.enable)
        self.eyes = Eyes(eyes)
        self._lock = threading.RLock()
        self._port = ArmPort(task.arm)  # no claim: it would outlive the check
        self._heard: dict[str, float] = {}  # on the steady clock [s]
        self._said = REST
        arms = (task.arm, task.camera.arm)
        self._participant = Participant(
            {task.arm: self._port},
            self._act,
            arms,
            lockstep=task.lockstep,
            listen=False,
            lock=self._lock,
        )
        self._participant.inputs += [
            rospy.Subscriber(
                f"/{name}/cycle", RawCycle, self._on_cycle, name, queue_size=None, tcp_nodelay=True
            )
            for name in arms
        ]
        self._participant.inputs += self.eyes.inputs

    def _on_cycle(self, cycle: RawCycle, name: str) -> None:
        with self._lock:
            self._heard[name] = time.monotonic()
            self._participant.on_cycle(cycle, name)

    def _act(self, seen: Seen) -> bool | None:
        """One cycle of both arms, of which every fifth is read; with the lock held."""
        if self.finished.is_set():
            return None
        if not self.check.done and seen.tick % PERIOD_TICKS == 0:
            self._look(seen)
        if self.check.done:
            self.finished.set()
        return self.check.done

    def _look(self, seen: Seen) -> None:
        scope = seen.cycles[self.task.camera.arm].read()
        if self.eyes.problem:
            self._send(self.check.stop(self.eyes.problem))
        else:
            q = np.array(scope.q)
            known = q.shape == (self.task.camera.chain.dof,) and bool(np.isfinite(q).all())
            R_WV = self.task.camera.view(q) if known else None
            R_WB = np.asarray(self.task.cell.arms[self.task.arm].X_WB)[:3, :3]
            view = seen.view(self.task.arm, R_WB)
            commands = self.check.tick(view, R_WV, self.eyes.newest)
            self._send(commands)
        self._tell()

    def _send(self, commands: ArmCommands) -> None:
        self._port.send(commands)

    def _tell(self) -> None:
        """What a viewer must see now, once for every step."""
        check = self.check
        if check.step != self._said and check.stage is Stage.GO and check.step.side:
            self._said = check.step
            print(f"the tip must now go: {WORDS[check.step]}", flush=True)

    def listen(self) -> None:
        """Free-run: ends the check once an arm is silent; without its cycles nothing else would."""
        if self.task.lockstep:
            return
        with self._lock:
            oldest = min(self._heard, key=lambda name: self._heard[name])
            if time.monotonic() - self._heard[oldest] > SILENCE and not self.finished.is_set():
                self._send(self.check.stop(f"{oldest} is silent: is its controller running?"))
                self.finished.set()

    def stop(self, reason: str) -> None:
        """Whatever is under way ends: the arm holds."""
        with self._lock:
            self._send(self.check.stop(reason))

    def connect(self) -> None:
        """Waits for everybody; in lock-step then answers tick 1, before which there is no cycle.

        Raises:
            TimeoutError: Somebody is missing; says who.
            OSError: The master does not answer.
        """
        self._participant.connect(
            CONNECT_TIMEOUT,
            over=lambda: bool(rospy.is_shutdown() or self.finished.is_set()),
            also=self._mute,
        )

    def _mute(self) -> str:
        silent = "" if self.task.lockstep else ", ".join(self._participant.silent)
        return f"{silent} has said nothing yet: is its controller running?" if silent else ""

    def verdict(self) -> tuple[Verdict, dict[str, Place]]:
        """What the pictures say, and where the tip was in them."""
        lens = self.eyes.lens()
        if self.check.reason or lens is None:
            return not_seen(self.check.reason or "no camera_info has come"), {}
        try:
            places = find_places(*split(self.check.pictures))
        except NotSeen as error:
            return not_seen(str(error)), {}
        return judge(places, lens), {str(step): place for step, place in places.items()}


def report(verdict: Verdict, places: dict[str, Place], task: Task) -> dict[str, Any]:
    """The verdict as JSON: numbers that are none are null."""
    return {
        "format": "surg_check_frames/1",
        "cell": str(task.cell.folder),
        "arm": task.arm,
        "endoscope": task.camera.arm,
        "outcome": verdict.outcome.value,
        "cause": verdict.cause.value,
        "text": verdict.text,
        "angle_rad": None if math.isnan(verdict.angle) else round(verdict.angle, 4),
        "seen": [
            {
                "told": seen.commanded,
                "pixels": [round(float(v), 2) for v in seen.pixels],
                "disparity": None if seen.disparity is None else round(seen.disparity, 2),
            }
            for seen in verdict.seen
        ],
        "places": {
            step: {
                "left": [round(float(v), 2) for v in place.left],
                "disparity": None
                if place.disparity is None
                else [round(float(v), 2) for v in place.disparity],
            }
            for step, place in places.items()
        },
    }


@dataclass(frozen=True)
class Parameters:
    """Parameters of the node."""

    cell: str = text()
    arm: str = text("", empty=True)
    enable: bool = flag(False)
    lockstep: bool = flag(False)
    out: Path | None = path(None)


def read_task(parameters: dict[str, Any]) -> Task:
    """Reads the cell and every parameter once.

    Raises:
        ParamError: A parameter must not be used.
        ConfigError: The cell must not be used.
    """
    given = read(Parameters, parameters)
    cell = surg_core.load_cell(given.cell)
    camera = held_camera(cell)
    if camera is None:
        raise ConfigError(
            f"check_frames: {cell.config.file}: no arm holds an endoscope (an instrument with a "
            "camera), so there is no registration of a camera to check; cells/sim_two_arms has one"
        )
    others = [name for name in cell.arms if name != camera.arm]
    arm = given.arm or (others[0] if others else "")
    if arm not in others:
        raise ParamError("arm", arm, ", ".join(others) or "none: the cell has one arm")
    return Task(cell, arm, camera, given.enable, given.lockstep, given.out)


def eyes_of(task: Task) -> tuple[str, ...]:
    """The eyes that send: both where the endoscope has two and both are published."""
    master, name = rosgraph.get_master_uri(), rospy.get_name()
    camera = task.cell.arms[task.camera.arm].instrument.camera
    wanted = EYES[: len(camera.frames)]
    deadline = time.monotonic() + CONNECT_TIMEOUT
    while time.monotonic() < deadline and not rospy.is_shutdown():
        found = [e for e in wanted if publishers(master, name, f"/endoscope/{e}/image_raw")]
        if "left" in found:
            time.sleep(0.2)  # the second eye is advertised right after the first
            return tuple(e for e in wanted if publishers(master, name, f"/endoscope/{e}/image_raw"))
        time.sleep(0.05)
    raise TimeoutError(
        "nobody publishes /endoscope/left/image_raw: is the endoscope running? './surg up CELL' "
        "starts it unless --no-video is given"
    )


def main() -> int:
    """Runs the node.

    Returns:
        The exit code.
    """
    if not rosgraph.is_master_online():
        print(f"check_frames: no ROS master at {rosgraph.get_master_uri()}", file=sys.stderr)
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
        node = CheckNode(task, eyes_of(task))
        node.connect()
        while not node.finished.wait(0.05) and not ended.is_set() and not rospy.is_shutdown():
            node.listen()
    except (OSError, TimeoutError) as error:
        print(f"check_frames: {error}", file=sys.stderr)
        return 1
    finally:
        if node is not None:
            node.stop("it was interrupted")
            time.sleep(FLUSH)
    verdict, places = node.verdict()
    found = report(verdict, places, task)
    if task.out is not None:
        left, right = split(node.check.pictures)
        shown = {f"left_{step}": picture for step, picture in left.items()}
        shown |= {f"right_{step}": picture for step, picture in (right or {}).items()}
        np.savez_compressed(task.out.with_suffix(".npz"), **shown)
        task.out.write_text(json.dumps(found, indent=1) + "\n", "utf-8")
    print(f"{verdict.outcome.value}: {verdict.text}", flush=True)
    rospy.signal_shutdown("check_frames: done")
    return 0 if verdict.outcome.value == "pass" else 1
