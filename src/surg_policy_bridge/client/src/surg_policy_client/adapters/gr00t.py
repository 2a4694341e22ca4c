"""A policy behind GR00T's inference service or a compatible server (ZeroMQ REQ/REP).

Each request is a msgpack map {endpoint, data}; arrays are maps with the bytes of an .npy file.
"""

from __future__ import annotations

import io
from typing import Any, Callable

import msgpack
import numpy as np
import zmq

from surg_policy_client.errors import BadAction, NoServer
from surg_policy_client.observation import Observation


class Gr00tPolicy:
    """Requests every chunk from a server.

    Args:
        address: Of the server, such as ``tcp://gpu-host:5555``.
        inputs: Converts an observation to the request's data. The public service takes it as
            keywords: ``{"observation": {...}, "options": None}``, with the keys of the
            checkpoint's embodiment.
        rows: Converts the reply to a chunk [K, A]; the public service replies ``[action, info]``.
        wants: Observations that `inputs` uses.
        timeout_s: Longest wait for an answer [s].
    """

    def __init__(
        self,
        address: str,
        inputs: Callable[[Observation], dict[str, Any]],
        rows: Callable[[Any], Any],
        wants: tuple[str, ...],
        timeout_s: float = 15.0,
    ) -> None:
        self._address, self._inputs, self._rows = address, inputs, rows
        self._timeout = timeout_s
        self._context = zmq.Context()
        self._socket: Any = None
        self.wants = wants
        self.name = "gr00t"

    def act(self, observation: Observation) -> np.ndarray:
        """The chunk [K, A] for the grid times after the observation's."""
        request = {"endpoint": "get_action", "data": self._inputs(observation)}
        reply = self._ask(msgpack.packb(request, default=_saved))
        if isinstance(reply, dict) and "error" in reply:
            raise BadAction(f"the server at {self._address}: {reply['error']}")
        return np.asarray(self._rows(reply))

    def _ask(self, request: bytes) -> Any:
        # A REQ socket whose answer is lost can do nothing more: the next question gets a new one.
        if self._socket is None:
            self._socket = self._context.socket(zmq.REQ)
            self._socket.setsockopt(zmq.LINGER, 0)
            self._socket.connect(self._address)
        self._socket.send(request)
        if not self._socket.poll(1000 * self._timeout):
            self._socket.close(0)
            self._socket = None
            raise NoServer(f"no answer from {self._address} within {self._timeout:g} s")
        return msgpack.unpackb(self._socket.recv(), object_hook=_loaded)


def _saved(value: Any) -> Any:
    if not isinstance(value, np.ndarray):
        raise TypeError(f"{type(value).__name__} does not go into a request")
    stream = io.BytesIO()
    np.save(stream, value, allow_pickle=False)
    return {"__ndarray_class__": True, "as_npy": stream.getvalue()}


def _loaded(value: Any) -> Any:
    if "__ndarray_class__" in value:
        return np.load(io.BytesIO(value["as_npy"]), allow_pickle=False)
    return value
