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
        api_token: The server's, if it asks for one.
    """

    def __init__(
        self,
        address: str,
        inputs: Callable[[Observation], dict[str, Any]],
        rows: Callable[[Any], Any],
        wants: tuple[str, ...],
        timeout_s: float = 15.0,
        api_token: str | None = None,
    ) -> None:
        self._address, self._inputs, self._rows = address, inputs, rows
        self._timeout = timeout_s
        self._token = {} if api_token is None else {"api_token": api_token}
        self._context = zmq.Context()
        self._socket: Any = None
        self.wants = wants
        self.name = "gr00t"

    def reset(self, instruction: str, seed: int | None) -> None:
        """A new episode; the service of GR00T N1.5 cannot be told."""
        try:
            self._ask("reset", {"options": None})
        except BadAction as error:
            if "Unknown endpoint" not in str(error):
                raise

    def act(self, observation: Observation) -> np.ndarray:
        """The chunk [K, A] for the grid times after the observation's."""
        return np.asarray(self._rows(self._ask("get_action", self._inputs(observation))))

    def _ask(self, endpoint: str, data: dict[str, Any]) -> Any:
        """The answer of the server.

        Raises:
            NoServer: It does not come.
            BadAction: It is an error.
        """
        request = {"endpoint": endpoint, "data": data, **self._token}
        answer = self._answer(msgpack.packb(request, default=_saved))
        try:
            reply = msgpack.unpackb(answer, object_hook=_loaded)
        except ValueError as error:  # older services say ERROR and nothing else
            raise BadAction(f"the server at {self._address} answered {answer[:40]!r}") from error
        if isinstance(reply, dict) and "error" in reply:
            raise BadAction(f"the server at {self._address}: {reply['error']}")
        return reply

    def _answer(self, request: bytes) -> bytes:
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
        answer: bytes = self._socket.recv()
        return answer


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
