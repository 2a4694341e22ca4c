"""Random delays of messages between processes: a library that tests preload into nodes."""

from __future__ import annotations

import functools
import subprocess
import tempfile
from pathlib import Path

SOURCE = Path(__file__).with_name("socket_jitter.cpp")


@functools.cache
def library() -> str:
    """The compiled library, built once per test process."""
    path = Path(tempfile.mkdtemp(prefix="socket_jitter_")) / "libsocket_jitter.so"
    subprocess.run(
        ["c++", "-std=c++17", "-O1", "-shared", "-fPIC", str(SOURCE), "-o", str(path), "-ldl"],
        check=True,
    )
    return str(path)


def environment(milliseconds: float, share: float = 0.25) -> dict[str, str]:
    """Environment in which processes delay what they send on sockets.

    Args:
        milliseconds: Longest delay; 0: none. Delays are uniform between 0 and this.
        share: Probability that a call is delayed.
    """
    return {
        "LD_PRELOAD": library(),
        "SOCKET_JITTER_MS": str(milliseconds),
        "SOCKET_JITTER_SHARE": str(share),
    }
