"""REQ and REP with msgpack and `numpy.save`: the serialiser of GR00T's inference service, our code.

There the robot is the client and the policy the server.
"""

from __future__ import annotations

import io
from typing import Any

import msgpack
import numpy as np
import zmq
from exchange import LEFT, RIGHT, STATE, Pictures, answer, main, robot
from numpy.typing import NDArray


def saved(value: Any) -> Any:
    """An array as the bytes of an .npy file."""
    if not isinstance(value, np.ndarray):
        raise TypeError(type(value))
    stream = io.BytesIO()
    np.save(stream, value, allow_pickle=False)
    return {"npy": stream.getvalue()}


def loaded(value: dict[str, Any]) -> Any:
    """The array of `saved`; other maps stay."""
    if "npy" not in value:
        return value
    return np.load(io.BytesIO(value["npy"]), allow_pickle=False)


def as_policy(address: str, keys: str) -> None:
    """Answers for ever."""
    socket = zmq.Context().socket(zmq.REP)
    socket.bind(address)
    while True:
        request = msgpack.unpackb(socket.recv(), object_hook=loaded)
        seen = request["data"]
        socket.send(msgpack.packb({"action": answer(seen[LEFT], seen[RIGHT])}, default=saved))


def as_robot(address: str, keys: str) -> None:
    """Asks."""
    socket = zmq.Context().socket(zmq.REQ)
    socket.connect(address)

    def ask(seen: Pictures, state: NDArray[np.float32]) -> NDArray[np.float32]:
        request = {"endpoint": "get_action", "data": {STATE: state, **seen}}
        socket.send(msgpack.packb(request, default=saved))
        chunk: NDArray[np.float32] = msgpack.unpackb(socket.recv(), object_hook=loaded)["action"]
        return chunk

    robot(ask)


if __name__ == "__main__":
    main(as_robot, as_policy)
