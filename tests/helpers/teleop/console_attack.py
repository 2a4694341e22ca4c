"""Attacks on a console of the loopback: `python console_attack.py PORT SECONDS KIND N [KIND N …]`.

``half-open N`` opens N connections that send half a header; ``connect N``, ``requests N``,
``pipelined N`` and ``pages N`` flood from N clients. Ends after SECONDS, or with its caller.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
import os
import struct
import sys
from collections.abc import AsyncIterator

HOST = "127.0.0.1"
GET = "GET / HTTP/1.1\r\nHost: localhost:{port}\r\n"


async def half_open(port: int) -> None:
    """Send half a header, wait; connect again when the console closes."""
    reader, writer = await asyncio.open_connection(HOST, port)
    writer.write(GET.format(port=port).encode())
    await reader.read()
    writer.close()
    await asyncio.sleep(1.0)


async def connect(port: int) -> None:
    """Connect and leave."""
    _, writer = await asyncio.open_connection(HOST, port)
    writer.close()


async def requests(port: int) -> None:
    """Ask for the page again and again over one connection."""
    reader, writer = await asyncio.open_connection(HOST, port)
    try:
        while True:
            writer.write(GET.format(port=port).encode() + b"\r\n")
            if not await reader.read(1 << 16):
                return
    finally:
        writer.close()


async def pipelined(port: int) -> None:
    """Ask a thousand times at once, without waiting for an answer."""
    reader, writer = await asyncio.open_connection(HOST, port)
    try:
        many = (GET.format(port=port).encode() + b"\r\n") * 1000
        drain = asyncio.create_task(reader.read())
        while not drain.done():
            writer.write(many)
            await writer.drain()
    finally:
        writer.close()


async def pages(port: int) -> None:
    """Join as a page and send messages as fast as the socket takes them."""
    reader, writer = await asyncio.open_connection(HOST, port)
    try:
        key = base64.b64encode(os.urandom(16)).decode()
        head = GET.format(port=port).replace("/ ", "/control ", 1)
        head += f"Origin: http://localhost:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        head += f"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: {key}\r\n\r\n"
        writer.write(head.encode())
        await reader.readuntil(b"\r\n\r\n")
        writer.write(_frame({"say": "hello", "token": ""}))
        drain = asyncio.create_task(reader.read())
        many = _frame({"say": "ping", "at": 1.0}) * 100
        while not drain.done():
            writer.write(many)
            await writer.drain()
            await asyncio.sleep(0)
    finally:
        writer.close()


def _frame(message: dict[str, object]) -> bytes:
    """A masked text frame of less than 126 bytes."""
    text = json.dumps(message).encode()
    return struct.pack("!BB4x", 0x81, 0x80 | len(text)) + text  # a mask of zeros


KINDS = {
    "half-open": half_open,
    "connect": connect,
    "requests": requests,
    "pipelined": pipelined,
    "pages": pages,
}


@contextlib.asynccontextmanager
async def attack(port: int, seconds: float, **waves: int) -> AsyncIterator[None]:
    """The attack, in a process of its own and at a lower priority."""
    words = [str(word) for kind, n in waves.items() for word in (kind.replace("_", "-"), n)]
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        *("-s", __file__, str(port), str(seconds), *words),
        stderr=asyncio.subprocess.DEVNULL,
        preexec_fn=lambda: os.nice(5),
    )
    try:
        await asyncio.sleep(1.0)
        yield
        assert process.returncode is None, "the attack ended early"
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.wait()


async def run(port: int, seconds: float, waves: dict[str, int]) -> None:
    """Run all clients for a time; each begins anew when the console ends its connection."""

    async def again(kind: str) -> None:
        while True:
            with contextlib.suppress(OSError, asyncio.IncompleteReadError):
                await KINDS[kind](port)
            await asyncio.sleep(0)

    clients = [asyncio.create_task(again(kind)) for kind, n in waves.items() for _ in range(n)]
    await asyncio.sleep(seconds)
    for client in clients:
        client.cancel()


if __name__ == "__main__":
    _, port, seconds, *words = sys.argv
    waves = dict(zip(words[::2], map(int, words[1::2]), strict=True))
    asyncio.run(run(int(port), float(seconds), waves))
