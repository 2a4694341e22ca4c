"""Our wire: a ROUTER with the codec on the robot's side, `serve` of the client on the other."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import zmq
import zmq.auth.thread
from exchange import COLUMNS, LEFT, RIGHT, STATE, Pictures, answer, main, pictures, robot
from numpy.typing import NDArray

from surg_policy_client import ActionSpec, Feature, Observation, Spec, serve, wire
from surg_policy_client.keys import server_keys
from surg_policy_client.wire import Message

SESSION = 1
SPEC = Spec(
    task="bench",
    period_s=0.05,
    observation={
        STATE: Feature(dtype="f4", shape=(9,)),
        **{key: Feature(dtype="u1", shape=each.shape) for key, each in pictures().items()},
    },
    action=ActionSpec(tuple(f"a{i}" for i in range(COLUMNS)), ("rad",) * COLUMNS),
)


def as_policy(address: str, keys: str) -> None:
    """The library as anybody uses it, with its thread and its pings."""

    def act(observation: Observation) -> NDArray[np.float32]:
        return answer(observation[LEFT], observation[RIGHT])

    serve(act, address, keys=keys or None, say=lambda text: None)


def as_robot(address: str, keys: str) -> None:
    """The socket with the model server's settings."""
    context = zmq.Context()
    socket = context.socket(zmq.ROUTER)
    socket.setsockopt(zmq.MAXMSGSIZE, wire.MAX_PART)
    socket.setsockopt(zmq.RCVHWM, 2)
    socket.setsockopt(zmq.SNDHWM, 8)
    if keys:
        own = server_keys(keys)
        guard = zmq.auth.thread.ThreadAuthenticator(context)
        guard.start()
        guard.configure_curve(domain="*", location=f"{keys}/server/clients")
        socket.curve_server = True
        socket.curve_publickey, socket.curve_secretkey = own.public, own.secret
    socket.bind(address)
    peer, seq = b"", 0

    def say(kind: str, head: dict[str, Any], arrays: Any = None) -> None:
        frames = wire.encode(Message(kind, head, arrays or {}))
        socket.send_multipart([peer, *frames], copy=False)

    def hear_one() -> Message:
        """The next message; a PING is answered."""
        nonlocal peer
        identity, *frames = wire.receive(socket)
        peer = identity.bytes
        message = wire.decode(frames)
        if message.kind == "PING":
            say("PONG", message.head)
        return message

    def hear(kind: str) -> Message:
        """The next message of this kind."""
        while True:
            message = hear_one()
            if message.kind == kind:
                return message

    def idle() -> None:
        """Answer pings until there is something to read."""
        poller = zmq.Poller()
        poller.register(socket, zmq.POLLIN)
        poller.register(sys.stdin.fileno(), zmq.POLLIN)
        while sys.stdin.fileno() not in dict(poller.poll()):
            hear_one()

    def ask(seen: Pictures, state: NDArray[np.float32]) -> NDArray[np.float32]:
        nonlocal seq
        seq += 1
        head = {"session": SESSION, "seq": seq, "stamp_ns": seq, "episode": 1, "step": seq}
        say("OBS", {**head, "instruction": "retract the bowel"}, {STATE: state, **seen})
        while (act := hear("ACT")).head["seq"] != seq:
            pass
        return act.arrays["chunk"]

    hear("HELLO")
    times = {"max_obs_age_s": 0.6, "ping_s": 0.05, "silence_s": 0.15}
    say("WELCOME", {"version": 1, "session": SESSION, "spec": SPEC.to_map(), **times})
    robot(ask, idle)


if __name__ == "__main__":
    main(as_robot, as_policy)
