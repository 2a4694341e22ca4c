"""Asks a websocket server through our adapter with openpi's own client; prints JSON.

openpi's package on PyPI has the client and the serialiser, and no server. This one answers by the
public protocol: a map on connecting, then a map for each map; a text with the trace of an error,
and the end of the connection.
"""

from __future__ import annotations

import json
import threading
import traceback
from contextlib import suppress
from importlib import metadata
from typing import Any

import numpy as np
from openpi_client import msgpack_numpy
from openpi_client.websocket_client_policy import WebsocketClientPolicy
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve

from surg_policy_client import ActionSpec, Observation, Spec
from surg_policy_client.adapters.openpi import OpenPiPolicy

STATE, LEFT = "observation.state", "observation.images.endoscope.left"
INPUTS = {"observation/image": LEFT, "observation/state": STATE}
ROWS, WIDE = 16, 32
"""A pi0 answers with 32 columns, whatever the arm has."""


class Model:
    """Its answer tells what it was asked, so that a number in a wrong place shows."""

    def __init__(self) -> None:
        self.asked: list[dict[str, Any]] = []

    def infer(self, request: dict[str, Any]) -> dict[str, Any]:
        """The state in the first columns; fails for a picture that is black."""
        self.asked.append(request)
        if not request["observation/image"].any():
            raise ValueError("a black picture")
        rows = np.zeros((ROWS, WIDE), np.float32)
        rows[:, :9] = request["observation/state"]
        rows[:, 9] = np.arange(ROWS)
        return {"actions": rows, "state": request["observation/state"]}


def answer(connection: ServerConnection, model: Model) -> None:
    """One connection."""
    connection.send(msgpack_numpy.packb({"model": "made up"}))
    with suppress(ConnectionClosed):
        while True:
            request = msgpack_numpy.unpackb(connection.recv())
            try:
                reply = {**model.infer(request), "server_timing": {"infer_ms": 0.1}}
            except ValueError:
                connection.send(traceback.format_exc())
                connection.close(1011, "internal error")
                return
            connection.send(msgpack_numpy.packb(reply))


def observation(picture: np.ndarray, state: np.ndarray) -> Observation:
    """As it comes off the wire: read-only."""
    for array in (picture, state):
        array.flags.writeable = False
    action = ActionSpec(tuple("abcde"), ("m",) * 5)
    return Observation(
        {STATE: state, LEFT: picture}, 0, 0, 0, "retract", Spec("bgr", 0.05, {}, action)
    )


def failure(policy: OpenPiPolicy, seen: Observation) -> dict[str, str]:
    """What `act` raises."""
    try:
        policy.act(seen)
    except Exception as error:
        return {"kind": type(error).__name__, "text": str(error)}
    return {}


def main() -> None:
    """Ask, let the model fail, and let the server go."""
    model = Model()
    server = serve(lambda c: answer(c, model), "127.0.0.1", 0, compression=None, max_size=None)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    port = server.socket.getsockname()[1]
    rng = np.random.default_rng(2)
    state = rng.normal(size=9).astype(np.float32)
    picture = rng.integers(1, 256, (480, 640, 3), dtype=np.uint8)
    remote = WebsocketClientPolicy("127.0.0.1", port)
    policy = OpenPiPolicy(remote, INPUTS, columns=[4, 3, 2, 1, 9])
    policy.reset("retract", 3)
    rows = policy.act(observation(picture, state))
    wanted = np.column_stack([np.tile(state[[4, 3, 2, 1]], (ROWS, 1)), np.arange(ROWS)])
    (asked,) = model.asked
    spec = observation(picture, state).spec
    said = {
        "openpi": metadata.version("openpi-client"),
        "metadata": remote.get_server_metadata(),
        "asked": sorted(asked),
        "prompt": asked["prompt"],
        "arrived": [
            bool(np.array_equal(asked["observation/image"], picture)),
            bool(np.array_equal(asked["observation/state"], state)),
        ],
        "shape": list(rows.shape),
        "worst": float(np.abs(rows - wanted).max()),
        "refused": spec.check_chunk(rows),
        "failed": failure(policy, observation(np.zeros_like(picture), state)),
        "gone": failure(policy, observation(picture, state)),
    }
    server.shutdown()
    thread.join()
    print(json.dumps(said))


if __name__ == "__main__":
    main()
