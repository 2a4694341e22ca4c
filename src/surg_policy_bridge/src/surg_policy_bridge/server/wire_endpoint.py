"""Frames of the wire on one side, messages of the model server on the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from surg_policy_bridge.server.model_server import ModelServer
from surg_policy_bridge.server.sessions import RateLimiter
from surg_policy_client import wire
from surg_policy_client.wire import WireError


class WireEndpoint:
    """Decodes what arrives, within a rate limit, and encodes what the server replies."""

    def __init__(self, server: ModelServer) -> None:
        self._server = server
        self._limiter = RateLimiter()

    def receive(self, peer: bytes, parts: Sequence[Any], now: int) -> None:
        """Take in the frames of one message; never raises, whatever they contain."""
        counters = self._server.counters
        counters.messages += 1
        if not self._limiter.admits(peer, now):
            counters.flooded += 1
            return
        try:
            message = wire.decode(parts)
        except WireError as error:
            self._server.refuse_malformed(peer, error)
        except Exception as error:  # an oversight in the codec must not end the server
            text = f"{type(error).__name__} {error}"[:300]
            self._server.refuse_malformed(peer, WireError("other", text))
        else:
            self._server.receive(peer, message, now)

    def take_frames(self) -> list[tuple[bytes, list[Any]]]:
        """Frames to send now, with the peer of each."""
        replies, self._server.replies = self._server.replies, []
        return [(peer, wire.encode(message)) for peer, message in replies]
