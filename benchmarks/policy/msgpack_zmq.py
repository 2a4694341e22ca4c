"""Plain msgpack: all in one frame, arrays as `bin`; ROUTER and DEALER, no threads, no checks."""

from __future__ import annotations

from typing import Any

import msgpack
import numpy as np
import zmq
from exchange import LEFT, RIGHT, STATE, Pictures, answer, main, robot
from numpy.typing import NDArray


def pack(fields: dict[str, Any]) -> bytes:
    """Arrays as maps of bytes, dtype and shape."""
    plain = {
        key: {"data": value.data, "dtype": value.dtype.str, "shape": value.shape}
        if isinstance(value, np.ndarray)
        else value
        for key, value in fields.items()
    }
    packed = msgpack.packb(plain)
    assert packed is not None
    return packed


def unpack(data: Any) -> dict[str, Any]:
    """The arrays again, as views of msgpack's bytes."""
    found = msgpack.unpackb(data, max_bin_len=8 << 20)
    return {
        key: np.frombuffer(value["data"], value["dtype"]).reshape(value["shape"])
        if isinstance(value, dict)
        else value
        for key, value in found.items()
    }


def as_policy(address: str, keys: str) -> None:
    """Answers for ever."""
    socket = zmq.Context().socket(zmq.DEALER)
    socket.connect(address)
    socket.send(b"")
    while True:
        seen = unpack(socket.recv(copy=False).buffer)
        chunk = answer(seen[LEFT], seen[RIGHT])
        socket.send(pack({"seq": seen["seq"], "chunk": chunk}), copy=False)


def as_robot(address: str, keys: str) -> None:
    """Asks."""
    socket = zmq.Context().socket(zmq.ROUTER)
    socket.bind(address)
    peer, _ = socket.recv_multipart()
    seq = 0

    def ask(seen: Pictures, state: NDArray[np.float32]) -> NDArray[np.float32]:
        nonlocal seq
        seq += 1
        head = {"seq": seq, "stamp_ns": seq, "step": seq, "instruction": "retract the bowel"}
        socket.send_multipart([peer, pack({**head, STATE: state, **seen})], copy=False)
        _, reply = socket.recv_multipart(copy=False)
        chunk: NDArray[np.float32] = unpack(reply.buffer)["chunk"]
        return chunk

    robot(ask)


if __name__ == "__main__":
    main(as_robot, as_policy)
