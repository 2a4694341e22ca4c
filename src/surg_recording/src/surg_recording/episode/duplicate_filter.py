"""Tells a message that came twice from one that was sent twice.

A subscriber can be connected to one publisher over two connections: its own registration and an
update by the master may race. Every message then arrives once on each. What has come over another
connection of the same publisher within the last seconds is a repeat; what comes again over the same
connection is news.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Hashable

WINDOW_S = 5.0
"""How far two connections may be apart [s]."""


class Deliveries:
    """What one publisher has delivered on one topic. Every connection may have its own thread."""

    def __init__(self, window_s: float = WINDOW_S) -> None:
        self.repeats = 0
        """Messages that were recognised as repeats."""
        self._window_s = window_s
        self._recent: deque[tuple[float, Hashable]] = deque()
        self._by_key: dict[Hashable, deque[set[int]]] = {}
        self._lock = threading.Lock()

    def repeated(self, connection: int, key: Hashable, now: float) -> bool:
        """Whether another connection has delivered this message already.

        Args:
            connection: identity of the connection it came over.
            key: identity of the message: sequence number and stamp, or its content.
            now: steady clock [s]; never goes back by much.
        """
        with self._lock:
            self._forget(now)
            same = self._by_key.setdefault(key, deque())
            for delivered_by in same:
                if connection not in delivered_by:
                    delivered_by.add(connection)
                    self.repeats += 1
                    return True
            news = {connection}
            same.append(news)
            self._recent.append((now, key))
            return False

    def _forget(self, now: float) -> None:
        while self._recent and self._recent[0][0] < now - self._window_s:
            _, key = self._recent.popleft()
            same = self._by_key[key]
            same.popleft()  # the oldest of a key is the oldest of all
            if not same:
                del self._by_key[key]
