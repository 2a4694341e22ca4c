"""Recognises messages that arrive twice over two connections to the same publisher.

A subscriber may connect twice to one publisher when its own registration races with an update from
the master. Each message then arrives once per connection. A message that another connection has
delivered within the last seconds is a duplicate; one that repeats on the same connection was sent
twice and counts.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Hashable

WINDOW_S = 5.0
"""Largest delay between the two connections [s]."""


class DuplicateFilter:
    """Deliveries of one publisher on one topic. Each connection may have its own thread."""

    def __init__(self) -> None:
        self.duplicates = 0
        self._recent: deque[tuple[float, Hashable]] = deque()
        self._by_key: dict[Hashable, deque[set[int]]] = {}
        self._lock = threading.Lock()

    def is_duplicate(self, connection: int, key: Hashable, now: float) -> bool:
        """Whether another connection has already delivered this message.

        ``key`` is sequence number and stamp, or the content; ``now`` is the steady clock [s].
        """
        with self._lock:
            self._forget(now)
            same_key = self._by_key.setdefault(key, deque())
            for delivered_by in same_key:
                if connection not in delivered_by:
                    delivered_by.add(connection)
                    self.duplicates += 1
                    return True
            first_delivery = {connection}
            same_key.append(first_delivery)
            self._recent.append((now, key))
            return False

    def _forget(self, now: float) -> None:
        while self._recent and self._recent[0][0] < now - WINDOW_S:
            _, key = self._recent.popleft()
            same_key = self._by_key[key]
            same_key.popleft()  # the oldest delivery of a key is also the oldest of all
            if not same_key:
                del self._by_key[key]
