"""A peer that floods a model server: `python hostile_peer.py ADDRESS COUNT`.

Garbage, wrong counts, bad headers, shapes that lie, messages of 20,000 parts, frames above the
limit, raw bytes into the port, and connections without end. Prints how much was sent.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import socket
import sys
import time
from pathlib import Path

import msgpack
import zmq


def messages(rng: random.Random) -> list[list[bytes]]:
    """A message of every bad kind."""
    act = {"session": 1, "seq": 1, "stamp_ns": 0, "step0": 0}
    lie = {**act, "arrays": [{"key": "chunk", "dtype": "f8", "shape": [1 << 30, 1 << 30]}]}
    void = {**act, "arrays": [{"key": "chunk", "dtype": "f8", "shape": [0, *[1 << 23] * 3]}]}
    return [
        [rng.randbytes(rng.randint(0, 400))],
        [b"SPB1"],
        [b"SPB1\x04" + rng.randbytes(100)],
        [b"SPB1\x04" + msgpack.packb(act)],
        [b"SPB1\x04" + msgpack.packb(lie), b"x" * 8],
        [b"SPB1\x04" + msgpack.packb(void), b""],
        [b"SPB1\x01\x81\xa4deep" + b"\x91" * 100_000],
        [b"SPB1\x04" + b"\xdf\xff\xff\xff\xff" * 20],
        [b"SPB1\x06" + msgpack.packb({"session": 7, "n": 1})],
        [b"x"] * 20_000,
        [b"SPB1\x04" + msgpack.packb(act)] * 9,
        [bytes(1 << 20)] * 3,
    ]


def main(address: str, count: int) -> None:
    """Flood with so many messages, a raw connection with every tenth and two huge frames."""
    # A stranger has a machine of his own: here he only gets what nobody else wants.
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    with contextlib.suppress(OSError):  # where Linux shares the processor among sessions
        Path("/proc/self/autogroup").write_text("19", "ascii")
    rng = random.Random(7)
    context = zmq.Context()
    peers = []
    for _ in range(4):
        peer = context.socket(zmq.DEALER)
        peer.setsockopt(zmq.SNDHWM, 4)
        peer.setsockopt(zmq.LINGER, 2000)
        peer.connect(address)
        peers.append(peer)
    host, port = address.removeprefix("tcp://").split(":")
    kinds = messages(rng)
    sent, raw, end = 0, 0, time.monotonic() + LONGEST
    while sent < count and time.monotonic() < end:
        for peer in peers:
            try:
                peer.send_multipart(rng.choice(kinds), zmq.NOBLOCK)
            except zmq.Again:
                time.sleep(0.001)
                continue
            sent += 1
            if sent % 10 == 0:
                with socket.create_connection((host, int(port))) as stranger:
                    stranger.sendall(os.urandom(rng.randint(1, 2000)))
                raw += 1
    for _ in range(HUGE):
        peer = context.socket(zmq.DEALER)
        peer.connect(address)
        peer.send(bytes(9 << 20))
        peer.close(500)
    print(json.dumps({"messages": sent, "raw": raw, "huge": HUGE}), flush=True)
    context.destroy(2000)


LONGEST = 15.0
"""[s]"""
HUGE = 2

if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
