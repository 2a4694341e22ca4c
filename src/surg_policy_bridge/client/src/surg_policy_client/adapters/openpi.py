"""A policy of openpi, in this process or behind its websocket server.

::

    from openpi_client.websocket_client_policy import WebsocketClientPolicy

    remote = WebsocketClientPolicy("gpu-host", 8000)
    serve(OpenPiPolicy(remote, inputs={"observation/image": LEFT, "observation/state": STATE}))
"""

from __future__ import annotations

import sys
from typing import Any, Mapping

import numpy as np

from surg_policy_client.errors import BadAction, NoServer
from surg_policy_client.observation import Observation


class OpenPiPolicy:
    """Anything with openpi's ``infer(dict) -> {"actions": [K, A]}``.

    Args:
        policy: openpi's policy or its websocket client.
        inputs: Observation key for each input name of the policy.
        prompt: Input name of the instruction; empty: none.
        columns: Columns of the result that are the actions, in their order; default: the first.
    """

    def __init__(
        self,
        policy: Any,
        inputs: Mapping[str, str],
        prompt: str = "prompt",
        columns: slice | list[int] | None = None,
    ) -> None:
        self._policy, self._inputs, self._prompt = policy, dict(inputs), prompt
        self._columns = columns
        self.wants = tuple(dict.fromkeys(self._inputs.values()))
        self.name = "openpi"

    def reset(self, instruction: str, seed: int | None) -> None:
        """A new episode."""
        if hasattr(self._policy, "reset"):
            self._policy.reset()

    def act(self, observation: Observation) -> np.ndarray:
        """The chunk [K, A] for the grid times after the observation's.

        Raises:
            BadAction: The model failed, or answered no actions.
            NoServer: The connection to the server has ended.
        """
        request: dict[str, Any] = {name: observation[key] for name, key in self._inputs.items()}
        if self._prompt:
            request[self._prompt] = observation.instruction
        try:
            reply = self._policy.infer(request)
        except Exception as error:
            if _connection_ended(error):
                raise NoServer(f"the openpi server has ended the connection: {error}") from error
            if isinstance(error, RuntimeError):  # holds the trace of the server's error
                last = str(error).strip().splitlines()[-1:]
                raise BadAction(f"the openpi policy failed: {' '.join(last)}") from error
            raise
        if "actions" not in reply:
            raise BadAction(f"the openpi policy answered {', '.join(reply)} and no actions")
        rows = np.atleast_2d(np.asarray(reply["actions"]))
        action = observation.spec.action
        assert action is not None  # of every server
        chosen = slice(0, len(action.names)) if self._columns is None else self._columns
        chunk: np.ndarray = rows[:, chosen]
        return chunk


def _connection_ended(error: Exception) -> bool:
    # openpi's client imports websockets; a policy in this process may do without.
    known = sys.modules.get("websockets.exceptions")
    return isinstance(error, OSError) or (
        known is not None and isinstance(error, known.WebSocketException)
    )
