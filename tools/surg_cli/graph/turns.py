"""Short turns on the processor for what must answer soon, where the kernel knows them (Linux 6.12).

A process that asks for turns of a quarter of a millisecond instead of about three gets no more of
the processor, but gets it sooner after it has woken up: it goes before whoever is in the middle of
a longer turn. No privilege is needed. An older kernel takes the wish and forgets it; there, and
wherever the wish is refused, everything goes on as without it.
"""

from __future__ import annotations

import contextlib
import ctypes
import platform
from collections.abc import Iterator

SHORT_NS = 250_000
"""Length of a short turn [ns]."""

_SET, _GET = {"x86_64": (314, 315), "aarch64": (274, 275)}.get(platform.machine(), (0, 0))
"""Numbers of the system calls sched_setattr and sched_getattr."""
_ORDINARY = (0, 3)
"""SCHED_OTHER and SCHED_BATCH: the policies that have turns."""


class _Attributes(ctypes.Structure):
    """The kernel's struct sched_attr; `runtime` is the length of a turn, 0: the usual one."""

    _fields_ = (
        ("size", ctypes.c_uint32),
        ("policy", ctypes.c_uint32),
        ("flags", ctypes.c_uint64),
        ("nice", ctypes.c_int32),
        ("priority", ctypes.c_uint32),
        ("runtime", ctypes.c_uint64),
        ("deadline", ctypes.c_uint64),
        ("period", ctypes.c_uint64),
    )


def turn_ns() -> int:
    """Length of the calling thread's turns [ns]; 0: the kernel does not say."""
    attributes = _attributes()
    return int(attributes.runtime) if attributes is not None else 0


@contextlib.contextmanager
def short() -> Iterator[None]:
    """What the calling thread starts meanwhile has short turns, and so has what that starts."""
    attributes = _attributes()
    if attributes is None:
        yield
        return
    _set(attributes, SHORT_NS)
    try:
        yield
    finally:
        _set(attributes, 0)


def _attributes() -> _Attributes | None:
    """Of the calling thread; None: they cannot be had, or it is no ordinary thread."""
    attributes = _Attributes()
    size = ctypes.sizeof(attributes)
    if not _GET or _libc().syscall(_GET, 0, ctypes.byref(attributes), size, 0) != 0:
        return None
    return attributes if attributes.policy in _ORDINARY else None


def _set(attributes: _Attributes, turn: int) -> None:
    """Change the turn and leave everything else; a refusal changes nothing."""
    attributes.runtime = turn
    _libc().syscall(_SET, 0, ctypes.byref(attributes), 0)


def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)
