"""Questions to a UR's dashboard server, and programs to its script port."""

from __future__ import annotations

import socket
import time
from collections.abc import Sequence

DASHBOARD_PORT = 29999
SCRIPT_PORT = 30002
OLDEST = (5, 6)
"""PolyScope whose dashboard server tells serial number and remote control."""
_LONGEST = 4096


def ask(address: str, questions: Sequence[str], timeout: float = 1.0) -> list[str]:
    """Ask the dashboard server, one line each; returns its answers.

    Raises:
        OSError: It does not answer, not within the time [s] for each line, or it is another server.
    """
    with socket.create_connection((address, DASHBOARD_PORT), timeout) as peer:
        rest = b""
        answers = []
        for question in ("", *questions):  # the server greets first
            if question:
                peer.sendall(question.encode("ascii") + b"\n")
            deadline = time.monotonic() + timeout
            while b"\n" not in rest:
                peer.settimeout(max(deadline - time.monotonic(), 1e-6))
                data = peer.recv(_LONGEST)
                if not data or len(rest) > _LONGEST:
                    raise ConnectionError("the dashboard server sent no line")
                rest += data
            line, _, rest = rest.partition(b"\n")
            answers.append(line.decode("utf-8", "replace").strip())
            if "Dashboard Server" not in answers[0]:
                raise ConnectionError(f"port {DASHBOARD_PORT} belongs to something else than a UR")
    return answers[1:]


def age_cure(version: Sequence[int]) -> str:
    """What to do about a controller's version (major, minor, …); empty: it is new enough."""
    if tuple(version[:2]) >= OLDEST:
        return ""
    return f"PolyScope {'.'.join(map(str, OLDEST))} or newer is needed: update the robot"


def upload(address: str, program: str, timeout: float = 1.0) -> None:
    """Send a program; the controller begins it at once, if it is in remote control.

    Raises:
        OSError: The script port does not take it.
    """
    with socket.create_connection((address, SCRIPT_PORT), timeout) as peer:
        peer.sendall(program.encode("ascii"))
        peer.shutdown(socket.SHUT_WR)
