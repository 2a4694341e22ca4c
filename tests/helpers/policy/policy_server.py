"""A model server for tests of the client: says what a test tells it to, and notes what it hears."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import zmq
import zmq.auth.thread

from surg_policy_client.action_spec import ActionSpec
from surg_policy_client.keys import server_keys
from surg_policy_client.spec import Feature, Spec
from surg_policy_client.wire import MAX_PART, Message, WireError, decode, encode, receive

ACTION = ("x", "y", "z", "roll", "jaw")
STATE = ("tip_x", "tip_y", "tip_z", "roll", "jaw", "set_x", "set_y", "set_z", "roll_set")


def spec(task: str = "bgr", pictures: bool = False) -> Spec:
    """What a server of one arm has."""
    observation = {
        "observation.state": Feature(
            dtype="f4",
            shape=(9,),
            unit="m,m,m,rad,rad,m,m,m,rad",
            frame="rcm",
            names=tuple(f"PSM1/{name}" for name in STATE),
        ),
        "privileged.task_state": Feature(dtype="f8", shape=(2,), privileged=True),
    }
    if pictures:
        for side in ("left", "right"):
            key = f"observation.images.endoscope.{side}"
            observation[key] = Feature(dtype="u1", shape=(480, 640, 3))
    action = ActionSpec(
        names=tuple(f"PSM1/{name}" for name in ACTION),
        units=("m", "m", "m", "rad", "rad"),
        frame="rcm",
        low=(-0.1, -0.1, 0.0, -3.1416, 0.0),
        high=(0.1, 0.1, 0.2, 3.1416, 1.2),
    )
    return Spec(task, 0.05, observation, action)


class PolicyServer:
    """A ROUTER in a thread of its own.

    Args:
        served: What it has.
        address: To bind; a ``*`` for the port chooses one.
        keys: Folder of `./surg policy keys`; None: nobody is asked for a key.
        answer: Takes a HELLO's fields, returns an ERR to send instead of a WELCOME, or None.
        deaf: Whether it hears and answers nothing.

    Attributes:
        heard: Messages that came, with the time [s] of each.
        refused: Frames that were no messages.
    """

    def __init__(
        self,
        served: Spec | None = None,
        *,
        address: str = "tcp://127.0.0.1:*",
        keys: Path | None = None,
        answer: Callable[[dict[str, Any]], Message | None] = lambda hello: None,
        deaf: bool = False,
        session: int = 1,
    ) -> None:
        self.spec = self._served = served or spec()
        self.heard: list[tuple[float, Message]] = []
        self.refused: list[WireError] = []
        self.session = session
        self.deaf = deaf
        self._answer, self._peer, self._seq = answer, b"", 0
        self._stop, self._news = False, threading.Condition()
        self._context = zmq.Context()
        self._auth = None
        self._socket = self._context.socket(zmq.ROUTER)
        self._socket.setsockopt(zmq.MAXMSGSIZE, MAX_PART)
        self._socket.setsockopt(zmq.LINGER, 0)
        if keys is not None:
            own = server_keys(keys)
            self._auth = zmq.auth.thread.ThreadAuthenticator(self._context)
            self._auth.start()
            self._auth.configure_curve(domain="*", location=str(keys / "server" / "clients"))
            self._socket.curve_publickey = own.public
            self._socket.curve_secretkey = own.secret
            self._socket.curve_server = True
        self._socket.bind(address)
        self.address = self._socket.getsockopt(zmq.LAST_ENDPOINT).decode().rstrip("\0")
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def __enter__(self) -> PolicyServer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End it, as if the process had died: nobody is told."""
        self._stop = True
        self._thread.join()
        self._socket.close(0)
        if self._auth is not None:
            self._auth.stop()
        self._context.term()

    def _run(self) -> None:
        while not self._stop:
            with self._lock:
                if not self._socket.poll(0):
                    parts = None
                else:
                    parts = receive(self._socket)
            if parts is None:
                time.sleep(0.001)
                continue
            peer = parts[0].bytes
            try:
                message = decode(parts[1:])
            except WireError as error:
                self.refused.append(error)
                continue
            if self.deaf:
                continue
            self._take(peer, message)
            with self._news:
                self.heard.append((time.monotonic(), message))
                self._news.notify_all()

    def _take(self, peer: bytes, message: Message) -> None:
        if message.kind == "HELLO":
            error = self._answer(message.head)
            self._peer = peer
            self.say(error or self.welcome(message.head))
        elif message.head.get("session") != self.session:
            self.say(Message("ERR", {"code": "session", "text": "no such session"}), peer)
        elif message.kind == "PING":
            self.say(Message("PONG", dict(message.head)), peer)

    def welcome(self, hello: dict[str, Any]) -> Message:
        """The answer to a good HELLO."""
        wants = Spec.from_map(hello["wants"]) if hello["wants"] is not None else self.spec
        self._served = self.spec.only(list(wants.observation))
        head = {
            "version": 1,
            "session": self.session,
            "spec": self._served.to_map(),
            "max_obs_age_s": 0.6,
            "ping_s": 0.05,
            "silence_s": 0.15,
        }
        return Message("WELCOME", head)

    # --- what a test does -------------------------------------------------------------------------

    def say(self, message: Message, peer: bytes | None = None) -> None:
        """Send a message to the client."""
        self.send([self._peer if peer is None else peer, *encode(message)])

    def send(self, parts: Sequence[Any]) -> None:
        """Send frames, whatever they are."""
        with self._lock:
            self._socket.send_multipart(parts)

    def episode(self, number: int, event: str = "begin", success: bool | None = None) -> None:
        """Say that an episode begins, ends, is paused, is resumed."""
        head = {
            "session": self.session,
            "episode": number,
            "event": event,
            "instruction": "retract the bowel",
            "success": success,
            "reason": "as the test says",
        }
        self.say(Message("EPISODE", head))

    def observe(self, step: int, episode: int = 0, keys: Sequence[str] | None = None) -> int:
        """Send an observation; returns its number."""
        self._seq += 1
        head = {
            "session": self.session,
            "seq": self._seq,
            "stamp_ns": step * 50_000_000,
            "episode": episode,
            "step": step,
            "instruction": "retract the bowel",
        }
        arrays = {
            key: np.full(feature.shape or (), step % 256, np.dtype(feature.dtype))
            for key, feature in self._served.observation.items()
            if keys is None or key in keys
        }
        self.say(Message("OBS", head, arrays))
        return self._seq

    def ask(self, step: int, episode: int = 0, timeout_s: float = 5.0) -> Message:
        """Send an observation and wait for its answer."""
        seq = self.observe(step, episode)
        return self.wait(lambda m: m.kind == "ACT" and m.head["seq"] == seq, timeout_s)

    def wait(self, good: Callable[[Message], bool] | str, timeout_s: float = 5.0) -> Message:
        """The first message that is wanted: of a kind, or for which a function is true."""
        wanted = (lambda m: m.kind == good) if isinstance(good, str) else good
        with self._news:
            found = self._news.wait_for(
                lambda: next((m for _, m in self.heard if wanted(m)), None), timeout_s
            )
        assert found is not None, f"never heard; heard {[m.kind for _, m in self.heard][-20:]}"
        return found

    def forget(self) -> None:
        """Forget what was heard."""
        with self._news:
            self.heard.clear()
