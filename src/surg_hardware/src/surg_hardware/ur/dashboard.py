"""Questions to a UR's dashboard server, and programs to its script port.

Both may take seconds: nothing here is called from the loop of a driver.
"""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Sequence

DASHBOARD_PORT = 29999
SCRIPT_PORT = 30002
OLDEST = (5, 6)
"""PolyScope whose dashboard server tells serial number and remote control."""
POLYSCOPE_X = 10
"""Major version from which on a controller has no dashboard server."""
ANSWER = 10.0
"""[s] Longest wait for an answer, and for a program to start: the maker's library waits so long."""
_LONGEST = 4096
_LOOK = 0.02  # [s] between two looks whether a program has started


def ask(address: str, questions: Sequence[str], timeout: float = ANSWER) -> list[str]:
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


def version_cure(version: Sequence[int]) -> str:
    """What to do about a controller's version (major, minor, …); empty: it can be driven."""
    if version and version[0] >= POLYSCOPE_X:
        return "this is PolyScope X, which has no dashboard server: use an arm with PolyScope 5"
    if tuple(version[:2]) >= OLDEST:
        return ""
    return f"PolyScope {'.'.join(map(str, OLDEST))} or newer is needed: update the robot"


def upload(
    address: str,
    program: str,
    started: Callable[[], bool],
    wanted: Callable[[], bool],
    timeout: float = ANSWER,
) -> None:
    """Send a program, and keep the connection until the controller says that it has started.

    Args:
        address: Of the robot, in remote control.
        program: Text in URScript.
        started: Whether the controller says that the program runs.
        wanted: Whether it is still wanted; where not, it is not sent, or no longer waited for.
        timeout: Longest wait [s].

    Raises:
        OSError: The script port does not take it, or it has not started within the time.
    """
    with socket.create_connection((address, SCRIPT_PORT), timeout) as peer:
        if wanted():
            peer.sendall(program.encode("ascii"))
        deadline = time.monotonic() + timeout
        while wanted() and not started():
            if time.monotonic() > deadline:
                raise TimeoutError(f"the program has not started within {timeout:g} s")
            time.sleep(_LOOK)
