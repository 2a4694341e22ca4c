"""Robot API of an emulated PolyScope X controller: HTTP with JSON, no sockets.

It stands in the place of the dashboard server. An order is answered when it is done, as the maker's
public client library awaits it; in local control every order is forbidden.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from http import HTTPStatus
from typing import Any

from surg_emulators.ur.joint_motion import DT
from surg_emulators.ur.robot_states import EMERGENCY, RobotMode, Runtime
from surg_emulators.ur.ur_controller import UrController

ROOT = "/universal-robots/robot-api"
API_VERSION = "5.0.107"
LONGEST_REQUEST = 1 << 16
LONGEST_ORDER = 10.0
"""An order that is not done within this time fails [s]."""
_POWERED = (RobotMode.IDLE, RobotMode.RUNNING)
Done = Callable[[], bool]


class RobotApiSession:
    """One connected client.

    Attributes:
        closed: The connection must be closed.
    """

    def __init__(self, controller: UrController) -> None:
        self.closed = False
        self._controller = c = controller
        self._buffer = bytearray()
        self._done: Done | None = None  # of the order that is under way
        self._left = 0  # cycles for it
        self._asks: dict[str, Callable[[], dict[str, Any]]] = {
            "/openapi.json": lambda: {"info": {"title": "Robot API", "version": API_VERSION}},
            "/versions/v1": lambda: {"marketingVersion": ".".join(map(str, c.version[:3]))},
            "/system/v1/information": lambda: {"serialNumber": c.serial, "robotType": c.model},
            "/system/v1/controlmode": lambda: {"mode": "REMOTE" if c.remote else "LOCAL"},
            "/system/v1/operationalmode": lambda: {"mode": "AUTOMATIC" if c.remote else "MANUAL"},
            "/robotstate/v1/robotmode": lambda: {"mode": RobotMode(c.robot_mode).name},
            "/robotstate/v1/safetymode": lambda: {"mode": self._safety()},
            "/program/v1/state": lambda: {"state": c.program_state},
            "/program/v1/loaded": lambda: {"name": c.loaded or "Default program"},
            "/programs/v1": lambda: {"programs": []},
        }
        self._orders: dict[tuple[str, str], Callable[[], Done | bool]] = {
            ("/robotstate/v1/state", "POWER_ON"): lambda: self._power_on(),
            ("/robotstate/v1/state", "POWER_OFF"): lambda: self._power_off(),
            ("/robotstate/v1/state", "BRAKE_RELEASE"): lambda: self._release_brakes(),
            ("/robotstate/v1/state", "UNLOCK_PROTECTIVE_STOP"): c.unlock,
            ("/robotstate/v1/state", "RESTART_SAFETY"): c.release,
            ("/program/v1/state", "play"): c.play,
            ("/program/v1/state", "pause"): lambda: c.pause() and self._is(Runtime.PAUSED),
            ("/program/v1/state", "resume"): lambda: c.program is not None and c.play(),
            ("/program/v1/state", "stop"): lambda: self._stop(),
        }

    def receive(self, data: bytes) -> bytes:
        """Take bytes of the client; returns the answers that are ready."""
        self._buffer += data
        answers = bytearray()
        while self._done is None and not self.closed and (request := self._request()):
            answers += self._answer(*request)
        self.closed |= len(self._buffer) > LONGEST_REQUEST
        return bytes(answers)

    def output(self) -> bytes:
        """The answer to an order that is done, or that has failed by now."""
        if self._done is None:
            return b""
        self._left -= 1
        done = self._done()
        if not done and self._left > 0:
            return b""
        self._done = None
        return self._packed(HTTPStatus.OK if done else HTTPStatus.GATEWAY_TIMEOUT, {})

    def _request(self) -> tuple[str, str, bytes] | None:
        """Method, path and body of the next request; None: it is not complete."""
        head, separator, rest = bytes(self._buffer).partition(b"\r\n\r\n")
        if not separator:
            return None
        first, *lines = head.decode("latin-1").split("\r\n")
        fields = {
            name.lower(): value.strip() for name, _, value in (x.partition(":") for x in lines)
        }
        size, words = fields.get("content-length", "0"), first.split(" ")
        if not size.isdigit() or len(words) != 3:
            self.closed = True
            return None
        if len(rest) < int(size):
            return None
        self._buffer = bytearray(rest[int(size) :])
        return words[0], words[1], rest[: int(size)]

    def _answer(self, method: str, path: str, body: bytes) -> bytes:
        """The answer to a request; empty: to an order that is under way."""
        name = path.removeprefix(ROOT).rstrip("/")
        known = path.startswith(ROOT) and (name in self._asks or name == "/robotstate/v1/state")
        if not known:
            return self._packed(HTTPStatus.NOT_FOUND, {"message": f"{path} is not known"})
        if method == "GET" and name in self._asks:
            return self._packed(HTTPStatus.OK, self._asks[name]())
        if method != "PUT":
            return self._packed(HTTPStatus.METHOD_NOT_ALLOWED, {"message": method})
        if not self._controller.remote:
            return self._packed(HTTPStatus.FORBIDDEN, {"message": "only in remote mode"})
        return self._obey(name, body)

    def _obey(self, name: str, body: bytes) -> bytes:
        try:
            given = json.loads(body)
            order = self._order(name, given)
        except (ValueError, TypeError, KeyError, AttributeError):
            message = {"message": f"{name} does not take {body[:100]!r}"}
            return self._packed(HTTPStatus.UNPROCESSABLE_ENTITY, message)
        done = order()
        if callable(done):
            self._done, self._left = done, round(LONGEST_ORDER / DT)
            return b""
        return self._packed(HTTPStatus.OK if done else HTTPStatus.CONFLICT, {})

    def _order(self, name: str, given: Any) -> Callable[[], Done | bool]:
        if name == "/program/v1/loaded":
            wanted = str(given["name"])
            return lambda: self._controller.load(wanted)
        return self._orders[name, given["action"]]

    def _packed(self, status: HTTPStatus, content: dict[str, Any]) -> bytes:
        body = json.dumps({"message": status.phrase} | content).encode()
        head = f"HTTP/1.1 {status.value} {status.phrase}\r\nContent-Type: application/json\r\n"
        return f"{head}Content-Length: {len(body)}\r\n\r\n".encode() + body

    # --- words and orders of this interface -----------------------------------------------------

    def _safety(self) -> str:
        mode = self._controller.safety_mode
        return "EMERGENCY_STOP" if mode in EMERGENCY else mode.name

    def _is(self, runtime: Runtime) -> Done:
        return lambda: self._controller.runtime == runtime

    def _power_on(self) -> Done:
        self._controller.power_on()
        return lambda: self._controller.robot_mode in _POWERED

    def _power_off(self) -> Done:
        self._controller.power_off()
        return lambda: self._controller.robot_mode == RobotMode.POWER_OFF

    def _release_brakes(self) -> Done:
        self._controller.release_brakes()
        return lambda: self._controller.robot_mode == RobotMode.RUNNING

    def _stop(self) -> bool:
        self._controller.stop()
        return True
