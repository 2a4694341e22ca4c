"""Why there is probably no session, from the events of the socket, and what to do."""

from __future__ import annotations

import zmq

HANDSHAKE_FAILED = {
    zmq.EVENT_HANDSHAKE_FAILED_AUTH: "denied",
    zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL: "protocol",
    zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL: "protocol",
}
"""What each event of a failed handshake means."""
_HINTS = {
    "": "no server listens there. Start one (./surg run TASK --policy ADDRESS), or check the "
    "address and the firewall between the machines.",
    "connected": "a process listens there, but it is not a model server. Check that the address is "
    "the one that the server prints when it starts.",
    "protocol": "only one of server and client uses keys. If the server was started with keys, set "
    "`keys` to the policy's folder of `./surg policy keys`; otherwise omit it.",
    "denied": "the server does not know this client's key. Copy the policy's *.key to the "
    "server's folder `server/clients` (./surg policy keys) and restart the server.",
}


class ConnectionHint:
    """The hint by what the socket has met so far."""

    def __init__(self) -> None:
        self._met = ""

    @property
    def text(self) -> str:
        """Cause and cure, in words."""
        return _HINTS[self._met]

    def note(self, event: int) -> None:
        """Take in an event of the socket's monitor."""
        if event == zmq.EVENT_CONNECTED:
            self._met = self._met or "connected"
        elif event == zmq.EVENT_HANDSHAKE_SUCCEEDED:
            self._met = "connected"
        elif event == zmq.EVENT_CLOSED and self._met == "connected":
            self._met = ""  # reached nobody; a handshake's result stays valid
        else:
            self._met = HANDSHAKE_FAILED.get(event, self._met)
