"""Random delays of messages between processes: a library that tests preload into nodes."""

from __future__ import annotations

from helpers.graph.preload import library


def environment(milliseconds: float, share: float = 0.25) -> dict[str, str]:
    """Environment in which processes delay what they send on sockets.

    Args:
        milliseconds: Longest delay; 0: none. Delays are uniform between 0 and this.
        share: Probability that a call is delayed.
    """
    return {
        "LD_PRELOAD": library("socket_jitter"),
        "SOCKET_JITTER_MS": str(milliseconds),
        "SOCKET_JITTER_SHARE": str(share),
    }
