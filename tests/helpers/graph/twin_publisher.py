"""A second connection to a publisher: another way to the same node, with the same messages.

roscpp publishers can be connected to one listener twice; rospy's cannot. A twin answers the slave
interface and the wire protocol as the publisher does, under its name, and sends what it is given.
"""

from __future__ import annotations

import io
import socket
import struct
import threading
from typing import Any
from xmlrpc.server import SimpleXMLRPCServer

import roslib.message


def _header(fields: dict[str, str]) -> bytes:
    entries = [f"{key}={value}".encode() for key, value in fields.items()]
    body = b"".join(struct.pack("<I", len(entry)) + entry for entry in entries)
    return struct.pack("<I", len(body)) + body


class TwinPublisher:
    """Says of itself that it is ``caller`` and publishes ``topic``."""

    def __init__(self, caller: str, topic: str, kind: str) -> None:
        found = roslib.message.get_message_class(kind)
        self._header = _header(
            {
                "callerid": caller,
                "topic": topic,
                "type": kind,
                "md5sum": found._md5sum,
                "message_definition": found._full_text,
                "latching": "0",
            }
        )
        self._wire = socket.create_server(("127.0.0.1", 0))
        self._slave = SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False, allow_none=True)
        self._slave.register_function(self._request, "requestTopic")
        self.uri = f"http://127.0.0.1:{self._slave.server_address[1]}/"
        self.listener: socket.socket | None = None
        threading.Thread(target=self._slave.serve_forever, daemon=True).start()
        threading.Thread(target=self._accept, daemon=True).start()

    def send(self, message: Any) -> None:
        """Send a message as it went out on the first connection, sequence number and all."""
        assert self.listener is not None
        body = io.BytesIO()
        message.serialize(body)
        data = body.getvalue()
        self.listener.sendall(struct.pack("<I", len(data)) + data)

    def close(self) -> None:
        """End both interfaces."""
        self._slave.shutdown()
        self._slave.server_close()
        self._wire.close()
        if self.listener is not None:
            self.listener.close()

    def _request(self, caller: str, topic: str, protocols: list[Any]) -> list[Any]:
        return [1, "", ["TCPROS", "127.0.0.1", self._wire.getsockname()[1]]]

    def _accept(self) -> None:
        connection, _ = self._wire.accept()
        (size,) = struct.unpack("<I", connection.recv(4, socket.MSG_WAITALL))
        connection.recv(size, socket.MSG_WAITALL)
        connection.sendall(self._header)
        self.listener = connection
