"""The serial line of a drive, as the maker's SDK wants it, with short time-outs."""

from __future__ import annotations

import select
import termios
import time
from pathlib import Path

from dynamixel_sdk.port_handler import PortHandler

PATIENCE = 0.008
"""[s] For an answer, beside its time on the line; with USB adapters set to 1 ms."""
GONE = (OSError, termios.error)
"""What a port raises that is missing, taken or unplugged."""


class SerialPort(PortHandler):  # type: ignore[misc]
    """A port that waits for its answers instead of spinning, and not for longer than it must.

    Args:
        path: Of the device.
        baud: [bit/s].
        patience: For an answer [s].

    Raises:
        OSError: It cannot be opened, or another program has it.
    """

    def __init__(self, path: Path, baud: int, patience: float = PATIENCE) -> None:
        super().__init__(str(path))
        self._patience = patience
        self.setBaudRate(baud)
        self.ser.exclusive = True

    def setPacketTimeout(self, packet_length: int) -> None:
        """Begin to wait for an answer of so many bytes."""
        self.setPacketTimeoutMillis(self.tx_time_per_byte * packet_length + 1e3 * self._patience)

    def readPort(self, length: int) -> bytes:
        """Up to so many bytes; waits for the first of them until the time-out."""
        left = 1e-3 * (self.packet_timeout - self.getTimeSinceStart())
        select.select((self.ser,), (), (), min(max(left, 0.0), self._patience))
        return bytes(self.ser.read(length))

    def getCurrentTime(self) -> float:
        """[ms]."""
        return 1e3 * time.monotonic()
