"""What the web server keeps per socket: a message budget, an outbox, a viewer of pictures."""

from __future__ import annotations

import asyncio
from collections import deque
from dataclasses import dataclass, field

from surg_console.web.picture_queue import PictureQueue

MESSAGE_RATE, MESSAGE_BURST = 200.0, 600.0
"""[1/s] messages of a page in the long run, and at once after a pause."""


class MessageBudget:
    """Rate limit of one page's messages: a token bucket."""

    def __init__(self, now: float) -> None:
        self._tokens, self._updated = MESSAGE_BURST, now

    def spend(self, now: float) -> bool:
        """Take one token; False: none is left."""
        self._tokens = min(MESSAGE_BURST, self._tokens + (now - self._updated) * MESSAGE_RATE)
        self._updated = now
        if self._tokens < 1.0:
            return False
        self._tokens -= 1.0
        return True


class Outbox:
    """Texts waiting for one page: all replies in order, but only the newest of each status."""

    def __init__(self) -> None:
        self._replies: deque[str] = deque(maxlen=32)
        self._status: dict[str, str] = {}
        self._changed = asyncio.Event()

    def reply(self, text: str) -> None:
        """Queue a text."""
        self._replies.append(text)
        self._changed.set()

    def update(self, kind: str, text: str) -> None:
        """Replace the status of this kind."""
        self._status[kind] = text
        self._changed.set()

    async def take(self) -> list[str]:
        """Wait for texts and take them all."""
        await self._changed.wait()
        self._changed.clear()
        texts = [*self._replies, *self._status.values()]
        self._replies.clear()
        self._status.clear()
        return texts


@dataclass(eq=False)
class Viewer:
    """One picture socket."""

    queue: PictureQueue = field(default_factory=PictureQueue)
    stream: tuple[str, str] | None = None  # layout and codec that the page watches
    spacing: int = 0  # that it wants between two pictures [ms]
    changed: asyncio.Event = field(default_factory=asyncio.Event)  # there may be one to send
