"""Queue of pictures to one page: at most one waits, and the newest replaces it.

H.264 pictures depend on earlier ones: after a drop the queue stays empty until the next key
picture, which it requests. A page that has not drawn the pictures it was sent gets no more, so
pictures do not pile up in socket buffers either.
"""

from __future__ import annotations

from surg_console.web.picture_packet import Packet

IN_FLIGHT = 3
"""Pictures that may be sent and not drawn yet."""
KEY_PERIOD = 0.2
"""[s] Interval between two requests for a key picture."""
STALLED = 2.0
"""[s] Pictures not drawn after this count as lost."""


class PictureQueue:
    """Pictures of one page; time is an argument [s]."""

    def __init__(self) -> None:
        self.dropped = 0
        """Pictures that were not sent."""
        self._waiting: Packet | None = None
        self._needs_key = True
        self._key_requested = -1e9
        self._in_flight: dict[int, float] = {}

    def put(self, packet: Packet) -> None:
        """Add a new picture."""
        if self._needs_key and not packet.key:
            self.dropped += 1
            return
        if self._waiting is not None:
            self.dropped += 1
            self._waiting = None
            if not packet.key:  # depends on the picture just dropped
                self.dropped += 1
                self._needs_key = True
                return
        self._waiting, self._needs_key = packet, False

    def wants_key(self, now: float) -> bool:
        """Whether to request a key picture now."""
        if not self._needs_key or now - self._key_requested < KEY_PERIOD:
            return False
        self._key_requested = now
        return True

    def take(self, now: float) -> Packet | None:
        """The picture to send now, or None."""
        for seq in [s for s, sent in self._in_flight.items() if now - sent > STALLED]:
            del self._in_flight[seq]
        if self._waiting is None or len(self._in_flight) >= IN_FLIGHT:
            return None
        packet, self._waiting = self._waiting, None
        self._in_flight[packet.seq] = now
        return packet

    def drawn(self, seq: int) -> None:
        """The page has drawn this picture, and with it all earlier ones."""
        for earlier in [s for s in self._in_flight if s <= seq]:
            del self._in_flight[earlier]
