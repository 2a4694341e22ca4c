"""What every driver's process needs of the machine: a lock, a priority, an end with its parent."""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import ipaddress
import math
import os
import signal
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

_PR_SET_PDEATHSIG = 1
_LOCK_CURRENT_AND_FUTURE = 3


class NotHere(Exception):
    """This machine must not drive this robot, or not twice; says why."""


def is_emulated(address: str) -> bool:
    """Whether an address is on this machine's loopback: an emulator."""
    return ipaddress.IPv4Address(address).is_loopback


def finite(values: Iterable[float]) -> bool:
    """Whether all values are finite numbers."""
    return all(map(math.isfinite, values))


@contextlib.contextmanager
def alone(address: str) -> Iterator[None]:
    """Hold the lock of a robot: one driver for each, on this machine.

    Raises:
        NotHere: Another driver holds it.
    """
    file = Path(tempfile.gettempdir()) / f"surg_hardware_{address}.lock"
    descriptor = os.open(file, os.O_CREAT | os.O_RDWR | os.O_NOFOLLOW, 0o666)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(descriptor)
        raise NotHere("another driver of this machine drives this robot: end it first") from error
    try:
        yield
    finally:
        os.close(descriptor)


def die_with_parent() -> None:
    """Get SIGTERM when the node that has started this process ends, however it ends."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)


def realtime(priority: int, address: str) -> bool:
    """Ask for a real-time priority (SCHED_FIFO) and locked memory; returns whether it was granted.

    Raises:
        NotHere: It was not, and the robot is not emulated.
    """
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        if is_emulated(address):
            return False
        raise NotHere(
            f"hardware.realtime: priority {priority} is not granted ({error.strerror}): raise the "
            "limit (ulimit -r), or run as a user who may"
        ) from error
    ctypes.CDLL(None).mlockall(_LOCK_CURRENT_AND_FUTURE)
    return True
