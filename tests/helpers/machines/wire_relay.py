"""A bad cable in user space: passes Ethernet frames between two interfaces, late or not at all.

A program of its own, because it lives in a network namespace of its own::

    wire_relay.py IF_A IF_B SEED

Lines on stdin, answered by ``ok`` on stdout: ``delay MS [JITTER_MS]`` (each way), ``loss SHARE``,
``stall S`` (everything waits, then comes at once, as behind a switch that hiccups), ``cut`` and
``mend`` (the plug). A queue is bounded: a frame too many is dropped, as by any cable.
"""

from __future__ import annotations

import heapq
import random
import select
import socket
import sys
import time

PACKET_VNET_HDR = 15
SOL_PACKET = 263
ETH_P_ALL = 0x0003
MOST_FRAMES = 20_000
LARGEST = 1 << 17


def packet_socket(interface: str) -> socket.socket:
    """A socket that sees and sends whole frames.

    With the header that says which checksums and segments the kernel has left to the hardware:
    passed on unchanged, the receiver knows them too.
    """
    wire = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ETH_P_ALL))
    wire.setsockopt(SOL_PACKET, PACKET_VNET_HDR, 1)
    wire.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 24)
    wire.bind((interface, 0))
    wire.setblocking(False)
    return wire


class Cable:
    """What happens to a frame between two ends.

    Args:
        seed: Of loss and jitter.
    """

    def __init__(self, seed: int) -> None:
        self.delay = self.jitter = self.loss = self.stalled_until = 0.0
        self.plugged = True
        self.lost = 0
        self._random = random.Random(seed)
        self._queue: list[tuple[float, int, int, bytes]] = []
        self._count = 0
        self._last = [0.0, 0.0]

    def put(self, end: int, frame: bytes, now: float) -> None:
        """A frame has come in at one end."""
        if not self.plugged or len(self._queue) >= MOST_FRAMES or self._random.random() < self.loss:
            self.lost += 1
            return
        due = max(now, self.stalled_until) + self.delay + self._random.uniform(0.0, self.jitter)
        due = self._last[end] = max(due, self._last[end])  # a cable does not reorder
        self._count += 1
        heapq.heappush(self._queue, (due, self._count, 1 - end, frame))

    def take(self, now: float) -> tuple[int, bytes] | None:
        """A frame that leaves now: the end it leaves at, and its bytes."""
        if not self._queue or self._queue[0][0] > now:
            return None
        _, _, end, frame = heapq.heappop(self._queue)
        return (end, frame) if self.plugged else self.take(now)

    def wait(self, now: float) -> float:
        """Seconds until the next frame is due, at most 0.1."""
        return min(0.1, max(0.0, self._queue[0][0] - now)) if self._queue else 0.1

    def obey(self, line: str, now: float) -> None:
        """One command."""
        word, *values = line.split()
        numbers = [float(value) for value in values]
        if word == "delay":
            self.delay = numbers[0] / 1000.0
            self.jitter = numbers[1] / 1000.0 if len(numbers) > 1 else 0.0
        elif word == "loss":
            self.loss = numbers[0]
        elif word == "stall":
            self.stalled_until = now + numbers[0]
        elif word in ("cut", "mend"):
            self.plugged = word == "mend"
        else:
            raise ValueError(f"no command {word!r}")


def main(first: str, second: str, seed: int) -> int:
    """Passes frames until stdin ends."""
    wires = [packet_socket(first), packet_socket(second)]
    cable = Cable(seed)
    print("ok", flush=True)
    while True:
        ready, _, _ = select.select([*wires, sys.stdin], [], [], cable.wait(time.monotonic()))
        now = time.monotonic()
        if sys.stdin in ready:
            line = sys.stdin.readline()
            if not line:
                return 0
            cable.obey(line, now)
            print("ok", flush=True)
        for end, wire in enumerate(wires):
            if wire not in ready:
                continue
            for _ in range(64):
                try:
                    frame, (_, _, kind, *_) = wire.recvfrom(LARGEST)
                except BlockingIOError:
                    break
                if kind != socket.PACKET_OUTGOING:
                    cable.put(end, frame, now)
        while (leaving := cable.take(time.monotonic())) is not None:
            end, frame = leaving
            try:
                wires[end].send(frame)
            except OSError:  # the other end is down or full: the frame is lost, as on any cable
                cable.lost += 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2], int(sys.argv[3])))
