"""Questions and orders to the dashboard server of PolyScope 5: a line, and its answer."""

from __future__ import annotations

import socket
import time
from collections.abc import Sequence

from surg_hardware.ur.orders import ANSWER, LOCAL, Order

DASHBOARD_PORT = 29999
_LONGEST = 4096
_OBEYS = {
    Order.POWER_ON: "Powering on",
    Order.POWER_OFF: "Powering off",
    Order.RELEASE_BRAKES: "Brake releasing",
    Order.UNLOCK: "Protective stop releasing",
    Order.RESTART_SAFETY: "Restarting safety",
    Order.STOP: "Stopped",
}
"""How the answer to each order begins when the robot obeys."""


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


class Dashboard:
    """The dashboard server at an address, as `orders.Orders` describes it."""

    def __init__(self, address: str) -> None:
        self._address = address

    def version(self) -> str:
        """Of PolyScope."""
        return self._said("PolyscopeVersion")

    def identity(self) -> tuple[str, str]:
        """Serial number and model, without the series: UR5."""
        serial, model = ask(self._address, ("get serial number", "get robot model"))
        return serial, model

    def remote(self) -> bool:
        """Whether it is in remote control."""
        return self._said("is in remote control").lower() == "true"

    def running(self) -> bool:
        """Whether a program runs."""
        return self._said("running").lower() == "true"

    def robot_mode(self) -> str:
        """Such as RUNNING, of `Robotmode: RUNNING`."""
        return self._said("robotmode")

    def safety(self) -> str:
        """Such as PROTECTIVE_STOP."""
        return self._said("safetystatus")

    def order(self, order: Order, timeout: float = ANSWER) -> str:
        """Give an order; returns why the robot does not obey, or nothing."""
        remote, answer = ask(self._address, ("is in remote control", order.value), timeout)
        if remote.lower() != "true":
            return LOCAL
        if not answer.startswith(_OBEYS[order]):
            return answer
        if order is Order.UNLOCK:
            ask(self._address, ("close safety popup",), timeout)
        return ""

    def _said(self, question: str) -> str:
        """The answer, or what stands behind its colon."""
        (answer,) = ask(self._address, (question,))
        return answer.rpartition(":")[2].strip()
