"""A model server on a fake clock, with an arm that obeys and a policy that speaks the wire."""

from __future__ import annotations

import functools
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import zmq
from numpy.typing import NDArray

import surg_core
from surg_cli.host import paths
from surg_core.arm_view import ArmCommands, ArmState, ArmView, TipPose
from surg_core.contract import SECOND_NS, STATE_KEY, STEP_NS
from surg_core.wrist_joints import WristView, joints_of_tip, tip_of_joints
from surg_policy_bridge.server import cell_spec
from surg_policy_bridge.server.model_server import ModelServer, ServerSettings, ServerState
from surg_policy_bridge.server.observer import Observation
from surg_policy_bridge.server.policy_arm import Target
from surg_policy_bridge.server.safety_controller import CLIPPED, SafetyController
from surg_policy_bridge.server.wire_endpoint import WireEndpoint
from surg_policy_client import wire
from surg_policy_client.observation import RCM
from surg_policy_client.spec import Spec
from surg_policy_client.wire import Message

Array = NDArray[np.float64]
ARM = "PSM1"
NODE = "/policy"
CELL = paths.ROOT / "cells" / "sim_ur5e"
WRISTED = paths.ROOT / "cells" / "sim_ur5e_wrist"
ORIENTATIONS = ("q_RTip", "q_RSet", "q_RGoal")
MS = 1_000_000
"""[ns]"""
HOME = np.array([0.0, 0.0, 0.12])
"""[m] Tip at the beginning, rcm frame."""


@functools.cache
def cell(path: Path = CELL) -> surg_core.Cell:
    """The cell of the bench."""
    return surg_core.load_cell(path)


def spec(path: Path = CELL) -> Spec:
    """What the bench serves."""
    return cell_spec.make(cell(path), [ARM], "bench", {}, None)


def arm_of(path: Path = CELL) -> surg_core.Arm:
    """The bench's arm."""
    return cell(path).arms[ARM]


class FakeArm:
    """An arm that does what a controller would: states, authority, a set-point that jumps."""

    def __init__(self, wrist: surg_core.WristConfig | None = None, turn: float = 0.7) -> None:
        self.view = ArmView(
            stamp_ns=0,
            state=ArmState.DISABLED,
            homed=False,
            busy=False,
            reason="",
            refused=0,
            p_BTip=HOME,
            p_BSet=HOME,
            jaw=0.3,
            jaw_set=0.3,
            R_BR=np.eye(3),
        )
        self.told: list[str] = []
        if wrist is not None:
            lengths = wrist.geometry
            geometry = surg_core.WristGeometry(lengths.pitch_to_yaw, lengths.yaw_to_tip, turn)
            straight, along = np.zeros(2), np.array([0.0, 0.0, 0.0, 1.0])
            seen = WristView(geometry, straight, straight, straight, along, along, along)
            self.view = replace(self.view, wrist=seen)

    def obey(self, command: ArmCommands, sender: str = NODE) -> None:
        """Take a command."""
        view = self.view
        if command.hold:
            self.told.append("hold")
        if command.state:
            self.told.append(command.state)
            if command.state == "home":
                view = replace(view, homed=True)
            elif command.state in ("enable", "resume"):
                view = replace(view, state=ArmState.ENABLED, reason="")
            elif command.state == "pause" and view.state == ArmState.ENABLED:
                view = replace(view, state=ArmState.PAUSED, reason="operator", holder="")
        if command.claim and view.holder in ("", sender):
            view = replace(view, holder=sender)
        if command.servo_cp is not None and command.jaw is not None and view.holder == sender:
            self.set(self.target_of(command.servo_cp, command.jaw))
            return
        self.view = view

    def target_of(self, pose: TipPose, jaw: float) -> Target:
        """The target that a commanded pose is."""
        if self.view.wrist is None:
            return Target(pose.p, pose.roll, jaw)
        wrist = self.view.wrist.geometry
        joints = joints_of_tip(wrist, surg_core.make_pose(pose.p, pose.q), self.view.roll_set)
        assert joints is not None
        return Target.of(np.array([*joints, jaw]), wrist)

    def set(self, target: Target) -> None:
        """The set-point is there."""
        tip = target.p
        if target.wrist is not None and self.view.wrist is not None:
            X_RTip = tip_of_joints(target.wrist, target.row)
            tip, q = X_RTip[:3, 3], surg_core.matrix_to_quaternion_xyzw(X_RTip[:3, :3])
            turns = dict.fromkeys(("measured", "set", "goal"), target.turns)
            wrist = replace(self.view.wrist, **turns, **dict.fromkeys(ORIENTATIONS, q))
            self.view = replace(self.view, wrist=wrist)
        self.view = replace(
            self.view,
            p_BTip=tip,
            p_BSet=tip,
            roll=target.roll,
            roll_set=target.roll,
            jaw=target.jaw,
            jaw_set=target.jaw,
        )


class Bench:
    """Time, arm, server and the frames of one policy.

    Attributes:
        now: [ns]
        sent: Targets that went to the arm, with the time of each.
        heard: Messages of the server to the policy.
    """

    def __init__(
        self,
        clip: Sequence[str] = CLIPPED,
        path: Path = CELL,
        turn: float = 0.7,
        **settings: Any,
    ) -> None:
        self.now = 1_000_000_000
        self.arm = FakeArm(cell(path).arms[ARM].instrument.wrist, turn)
        self.sessions = iter(range(7001, 9000))
        self.server = ModelServer(
            ServerSettings(arms=(ARM,), node=NODE, instruction="do it", **settings),
            SafetyController({ARM: arm_of(path)}, clip),
            lambda: next(self.sessions),
        )
        self.endpoint = WireEndpoint(self.server)
        self.server.serve(spec(path), self.now)
        self.sent: list[tuple[int, Target]] = []
        self.heard: list[Message] = []
        self.errors: list[tuple[bytes, str, str]] = []
        self.step = 0
        self.obstacle = ""

    # --- the policy -------------------------------------------------------------------------------

    def say(
        self, kind: str, peer: bytes = b"a", arrays: Any = None, seen: Any = None, **head: Any
    ) -> None:
        """A message of a policy."""
        parts = [bytes(part) for part in wire.encode(Message(kind, head, arrays or {}, seen))]
        self.endpoint.receive(peer, parts, self.now)
        self._hear()

    def hello(self, peer: bytes = b"a", **changes: Any) -> None:
        """HELLO."""
        head: dict[str, Any] = {
            "versions": [1, 1],
            "client": "bench",
            "software": "none",
            "policy": "bench",
            "wants": None,
        }
        self.say("HELLO", peer, **{**head, **changes})

    def ping(self, peer: bytes = b"a") -> None:
        """PING of the session."""
        self.say("PING", peer, session=self.session, n=1)

    @property
    def session(self) -> int:
        """Number of the newest session that was offered."""
        return int(self.of("WELCOME")[-1].head["session"])

    def of(self, kind: str) -> list[Message]:
        """What the server has said of this kind."""
        return [message for message in self.heard if message.kind == kind]

    def frames(
        self, rows: Any, first: int | None = None, seen: Any = None, **changes: Any
    ) -> list[bytes]:
        """Of an answer to the newest observation."""
        asked = self.of("OBS")[-1].head
        head = {
            "session": self.session,
            "seq": asked["seq"],
            "stamp_ns": asked["stamp_ns"],
            "step0": asked["step"] + 1 if first is None else first,
        }
        chunk = np.atleast_2d(np.asarray(rows, dtype=np.float64))
        answer = Message("ACT", {**head, **changes}, {"chunk": chunk}, seen)
        return [bytes(part) for part in wire.encode(answer)]

    def act(self, rows: Any, peer: bytes = b"a", **changes: Any) -> None:
        """Answer the newest observation."""
        self.endpoint.receive(peer, self.frames(rows, **changes), self.now)
        self._hear()

    def _hear(self) -> None:
        for peer, parts in self.endpoint.take_frames():
            message = wire.decode([bytes(part) for part in parts])
            if message.kind == "ERR":
                self.errors.append((peer, message.head["code"], message.head["text"]))
            self.heard.append(message)

    # --- time -------------------------------------------------------------------------------------

    def tick(self) -> None:
        """The server looks at everything."""
        view = replace(self.arm.view, stamp_ns=self.now)
        for command in self.server.tick({ARM: view}, self.now, self.now, self.obstacle).values():
            self.arm.obey(command)
        self._hear()

    def observe(self) -> None:
        """The observation of the present grid time."""
        numbers = np.array(self.arm.view.numbers, dtype="<f4")
        seen = Observation(self.step, self.now, {STATE_KEY: numbers, RCM: np.eye(4)[None]})
        self.server.observe(seen, self.now, self.now)
        self._hear()

    def execute(self) -> Target | None:
        """The step that is due now."""
        targets = self.server.execute(self.step + 1, self.now)
        self._hear()
        if not targets:
            return None
        self.sent.append((self.now, targets[ARM]))
        self.arm.obey(targets[ARM].commands())
        return targets[ARM]

    def period(self, rows: Any = None, ping: bool = True) -> Target | None:
        """One grid time: look, observe, answer with rows, execute; then the time passes."""
        if ping:
            self.ping()
        self.tick()
        self.observe()
        if rows is not None:
            self.act(rows)
        done = self.execute()
        self.now += STEP_NS
        self.step += 1
        return done

    def start(self, peer: bytes = b"a", **changes: Any) -> None:
        """Connect, enable, and wait until it runs."""
        self.hello(peer, **changes)
        self.tick()
        assert self.server.enable(True, self.now) == ""
        for _ in range(3):
            self.tick()
        assert self.server.state.value == "RUNNING", self.server.reason

    def here(self, *offset: float) -> Array:
        """An action at the set-point, moved by an offset [m]."""
        moved = np.zeros(5)
        moved[: len(offset)] = offset
        view = self.arm.view
        return np.array([*view.p_set, view.roll_set, view.jaw_set]) + moved


class WiredBench(Bench):
    """The same server behind a socket, in lock-step with a policy that comes over the wire.

    Attributes:
        lock: Held while the server works.
        address: Of the socket.
    """

    def __init__(self, **settings: Any) -> None:
        patient = {
            "silence": 60 * SECOND_NS,
            "max_obs_age": 60 * SECOND_NS,
            "empty": 60 * SECOND_NS,
        }
        super().__init__(**{**patient, **settings})
        self._context = zmq.Context()
        self._router = self._context.socket(zmq.ROUTER)
        port = self._router.bind_to_random_port("tcp://127.0.0.1")
        self.address = f"tcp://127.0.0.1:{port}"
        self.lock, self._stop = threading.Lock(), False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def __enter__(self) -> WiredBench:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop = True
        self._thread.join()
        self._router.close(0)
        self._context.term()

    def _clock(self) -> int:
        """The server's time [ns]."""
        return time.monotonic_ns()

    def _run(self) -> None:
        ran = False
        while not self._stop:
            with self.lock:
                self.now = self._clock()
                while self._router.poll(0):
                    peer, *parts = self._router.recv_multipart()
                    self.endpoint.receive(peer, parts, self.now)
                self.tick()
                begins = ran != (ran := self.server.state is ServerState.RUNNING)
                if ran and (begins or not self.server.unanswered):
                    self.execute()
                    self.step += 1
                    self.observe()
            time.sleep(0.002)

    def _hear(self) -> None:
        for peer, parts in self.endpoint.take_frames():
            self._router.send_multipart([peer, *parts])
