"""Questions and orders to the robot API of PolyScope X: HTTP with JSON, in place of a dashboard.

Its paths and words are those that the maker's public client library uses.
"""

from __future__ import annotations

import http.client
import json

from surg_hardware.ur.orders import ANSWER, LOCAL, Order

PORT = 80
ROOT = "/universal-robots/robot-api"
_LONGEST = 1 << 16
"""[bytes] Of an answer."""
_FORBIDDEN = 403
"""HTTP status of every order in local control."""
_STATE, _PROGRAM = "/robotstate/v1/state", "/program/v1/state"
_PUT = {
    Order.POWER_ON: (_STATE, "POWER_ON"),
    Order.POWER_OFF: (_STATE, "POWER_OFF"),
    Order.RELEASE_BRAKES: (_STATE, "BRAKE_RELEASE"),
    Order.UNLOCK: (_STATE, "UNLOCK_PROTECTIVE_STOP"),
    Order.RESTART_SAFETY: (_STATE, "RESTART_SAFETY"),
    Order.STOP: (_PROGRAM, "stop"),
}
"""Path and action of each order."""


class RobotApi:
    """The robot API at an address, as `orders.Orders` describes it."""

    def __init__(self, address: str) -> None:
        self._address = address

    def version(self) -> str:
        """Of PolyScope X."""
        return self._get("/versions/v1", "marketingVersion")

    def identity(self) -> tuple[str, str]:
        """Serial number and model."""
        path = "/system/v1/information"
        return self._get(path, "serialNumber"), self._get(path, "robotType")

    def remote(self) -> bool:
        """Whether it is in remote control."""
        return self._get("/system/v1/controlmode", "mode") == "REMOTE"

    def running(self) -> bool:
        """Whether a program runs."""
        return self._get(_PROGRAM, "state") == "PLAYING"

    def robot_mode(self) -> str:
        """Such as RUNNING."""
        return self._get("/robotstate/v1/robotmode", "mode")

    def safety(self) -> str:
        """Such as PROTECTIVE_STOP."""
        return self._get("/robotstate/v1/safetymode", "mode")

    def order(self, order: Order, timeout: float = ANSWER) -> str:
        """Give an order, which is answered when it is done; returns why it is not, or nothing."""
        path, action = _PUT[order]
        status, answer = self._request("PUT", path, {"action": action}, timeout)
        if status == _FORBIDDEN:
            return LOCAL
        return "" if status == http.client.OK else str(answer.get("message") or f"HTTP {status}")

    def _get(self, path: str, key: str) -> str:
        """One value of an answer.

        Raises:
            OSError: There is no such answer, or none with this value.
        """
        status, answer = self._request("GET", path, None, ANSWER)
        if status != http.client.OK or not isinstance(answer.get(key), str):
            raise ConnectionError(f"the robot API answers {path} by {status}, without {key!r}")
        return str(answer[key])

    def _request(
        self, method: str, path: str, body: dict[str, str] | None, timeout: float
    ) -> tuple[int, dict[str, object]]:
        """HTTP status, and the JSON of the answer; empty where it is no object."""
        peer = http.client.HTTPConnection(self._address, PORT, timeout)
        try:
            text = json.dumps(body) if body else None
            peer.request(method, ROOT + path, text, {"Content-Type": "application/json"})
            reply = peer.getresponse()
            data = reply.read(_LONGEST)
        except http.client.HTTPException as error:
            raise ConnectionError(f"port {PORT} is no robot API: {error!r}") from error
        finally:
            peer.close()
        try:
            found = json.loads(data)
        except ValueError:
            found = None
        return reply.status, found if isinstance(found, dict) else {}
