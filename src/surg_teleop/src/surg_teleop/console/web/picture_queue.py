"""The way of the pictures to one page: never more than one waits, and the newest wins.

A picture that nobody has fetched yet is dropped for the newer one. H.264 pictures build on each
other: after a drop the lane is empty until a key picture comes, which it asks for. A page that has
not drawn what it was sent gets no more: pictures must not pile up in sockets either.
"""

from __future__ import annotations

from surg_teleop.console.web.picture_packet import Packet

UNDER_WAY = 3
"""Pictures that may have been sent and not drawn yet."""
KEY_PERIOD = 0.2
"""[s] between two requests for a key picture."""
STALLED = 2.0
"""[s] after which pictures that were never drawn count as lost."""


class Lane:
    """One page's pictures; time is an argument [s]."""

    def __init__(self) -> None:
        self.dropped = 0
        """Pictures that were not sent."""
        self._waiting: Packet | None = None
        self._needs_key = True
        self._key_asked = -1e9
        self._under_way: dict[int, float] = {}

    def put(self, packet: Packet) -> None:
        """A new picture."""
        if self._needs_key and not packet.key:
            self.dropped += 1
            return
        if self._waiting is not None:
            self.dropped += 1
            self._waiting = None
            if not packet.key:  # it builds on the one that has just been dropped
                self.dropped += 1
                self._needs_key = True
                return
        self._waiting, self._needs_key = packet, False

    def wants_key(self, now: float) -> bool:
        """Whether a key picture is to be asked for now."""
        if not self._needs_key or now - self._key_asked < KEY_PERIOD:
            return False
        self._key_asked = now
        return True

    def take(self, now: float) -> Packet | None:
        """The picture that may be sent now, or None."""
        for seq in [s for s, sent in self._under_way.items() if now - sent > STALLED]:
            del self._under_way[seq]
        if self._waiting is None or len(self._under_way) >= UNDER_WAY:
            return None
        packet, self._waiting = self._waiting, None
        self._under_way[packet.seq] = now
        return packet

    def drawn(self, seq: int) -> None:
        """The page has drawn this picture, and with it all before."""
        for earlier in [s for s in self._under_way if s <= seq]:
            del self._under_way[earlier]
