"""openpi's own client and serialiser (openpi-client of PyPI) over its websocket.

There the robot is the client and the policy the server. The server below is ours, with the calls
and options of openpi's: `openpi_client` brings none.
"""

from __future__ import annotations

import asyncio
import time
from typing import Any

import numpy as np
import websockets.asyncio.server
from exchange import LEFT, RIGHT, STATE, Pictures, answer, main, robot
from numpy.typing import NDArray
from openpi_client import msgpack_numpy
from openpi_client.websocket_client_policy import WebsocketClientPolicy


def as_policy(address: str, keys: str) -> None:
    """Answers for ever."""
    host, port = address.removeprefix("tcp://").split(":")
    packer = msgpack_numpy.Packer()

    async def handle(connection: Any) -> None:
        await connection.send(packer.pack({}))
        async for data in connection:
            seen = msgpack_numpy.unpackb(data)
            await connection.send(packer.pack({"actions": answer(seen[LEFT], seen[RIGHT])}))

    async def run() -> None:
        options: dict[str, Any] = {"compression": None, "max_size": None}
        async with websockets.asyncio.server.serve(handle, host, int(port), **options) as server:
            await server.serve_forever()

    asyncio.run(run())


def as_robot(address: str, keys: str) -> None:
    """Asks."""
    host, port = address.removeprefix("tcp://").split(":")
    until = time.monotonic() + 20.0
    while True:
        try:
            policy = WebsocketClientPolicy(host, int(port))
            break
        except ConnectionRefusedError:
            if time.monotonic() > until:
                raise
            time.sleep(0.1)

    def ask(seen: Pictures, state: NDArray[np.float32]) -> NDArray[np.float32]:
        chunk: NDArray[np.float32] = policy.infer({STATE: state, **seen})["actions"]
        return chunk

    robot(ask)


if __name__ == "__main__":
    main(as_robot, as_policy)
