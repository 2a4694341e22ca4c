"""The process that drives one arm through its adapter, on the robot's own cycle, without ROS.

``python3 -m surg_hardware.adapter_driver SETTINGS FD``, see `arm_driver`. The settings' ``driver``
is the name of a link of the platform, or a folder with ``driver.py`` and a class ``Driver``.
"""

from __future__ import annotations

import importlib
import importlib.util
import socket
import sys
import time
from pathlib import Path

from surg_hardware.arm_driver import (
    AGAIN,
    FIRST_CONNECTION,
    STALE,
    ArmDriver,
    RobotRefused,
    serve,
)
from surg_hardware.conditions import OFFLINE
from surg_hardware.driver_datagrams import IdentityDatagram
from surg_hardware.driver_settings import DriverSettings
from surg_hardware.link_programs import ADAPTERS
from surg_hardware.robot_adapter import AdapterError, ArmState, RobotAdapter
from surg_hardware.robot_link import RobotState

FILE = "driver.py"


def load(driver: str) -> type[RobotAdapter]:
    """The adapter's class of a link of the platform, or in a folder.

    Raises:
        ValueError: There is none; says where it was looked for.
    """
    if driver in ADAPTERS:
        found = importlib.import_module(ADAPTERS[driver]).Driver
    else:
        file = Path(driver) / FILE
        spec = importlib.util.spec_from_file_location("robot_driver", file)
        if spec is None or spec.loader is None or not file.is_file():
            raise ValueError(f"driver: there is no {file}")
        module = importlib.util.module_from_spec(spec)
        sys.path.insert(0, str(file.parent))  # for modules beside it
        try:
            spec.loader.exec_module(module)
        except Exception as error:
            raise ValueError(f"driver: {file}: {type(error).__name__}: {error}") from error
        found = getattr(module, "Driver", None)
        if not (isinstance(found, type) and issubclass(found, RobotAdapter)):
            raise ValueError(
                f"driver: {file}: needs a class 'Driver' that inherits from "
                "surg_hardware.robot_adapter.RobotAdapter"
            )
    adapter: type[RobotAdapter] = found
    return adapter


class AdapterDriver(ArmDriver):
    """Drives one arm through its adapter; `run` returns when it shall end."""

    def __init__(
        self, settings: DriverSettings, node: socket.socket, adapter: RobotAdapter
    ) -> None:
        super().__init__(settings, node, adapter.cycle, adapter.clock_window)
        self._adapter = adapter
        self._connected = self._driving = False
        self._number = 0  # of the velocities sent last
        self._obeys = False
        self._heard = -1e9  # our clock

    @property
    def _may_move(self) -> bool:
        return self._driving

    def _close(self) -> None:
        if self._connected:
            self._adapter.close()

    def _turn(self) -> None:
        """Wait for the robot, and answer it with the node's newest command."""
        if not self._connected:
            self._read_node()
            self._say_lost()
            if time.monotonic() - self._tried > AGAIN:
                self._connect_again()
            time.sleep(0.01)
            return
        try:
            state = self._adapter.state()
        except TimeoutError:
            self._read_node()
            if time.monotonic() - self._heard > STALE:
                self._say_lost()
            return
        except AdapterError as error:
            self._disconnect(str(error))
            return
        self._read_node()
        self._cycle(state, time.monotonic())

    def _cycle(self, arm: ArmState, now: float) -> None:
        """Answer one state of the robot."""
        self._heard, self._obeys = now, arm.obeys
        state = RobotState(
            arm.time,
            arm.q,
            arm.qd,
            arm.reading,
            program=arm.obeys,
            executed=self._number,
            ahead=arm.ahead,
            wrench=arm.wrench,
        )
        step = self._step(state, now)
        if step is None:
            return
        try:
            if step.qd is not None and self._link.active:
                self._adapter.send(step.qd)
                self._number, self._driving = step.number, True
            elif self._driving:
                self._adapter.stop()
                self._driving = arm.obeys  # until it has come to rest
        except AdapterError as error:
            self._driving = False
            self._adapter.stop()
            self._link.end(str(error))
            self._notice(str(error))
        self._report(state, step.status, now)
        if not arm.obeys and self._identity_is_due(now):
            self._say_identity(arm)

    # --- the connection -------------------------------------------------------------------------

    def _connect_first(self) -> None:
        deadline = time.monotonic() + FIRST_CONNECTION
        while not self._ended:
            try:
                self._adapter.connect()
                self._connected = True
                return
            except AdapterError as error:
                if time.monotonic() > deadline:
                    raise TimeoutError(f"hardware.address: {error}") from error
                time.sleep(0.1)

    def _connect_again(self) -> None:
        self._tried = time.monotonic()
        try:
            self._adapter.connect()
        except AdapterError as error:
            self._notice(str(error))
            return
        self._connected, self._identified = True, -1e9
        self._clock.reset()

    def _disconnect(self, why: str) -> None:
        self._adapter.close()
        self._connected = self._driving = False
        self._notice(f"the connection to the robot has ended: {why}")
        self._say_lost()

    # --- requests of the node -------------------------------------------------------------------

    def _obey(self, word: str, enabled: bool) -> str:
        return super()._obey(word, enabled) if self._connected else OFFLINE.text

    def _start(self, enabled: bool) -> str:
        if self._obeys and not self._link.active:
            return "the arm is still coming to rest: wait"
        return self._link.start(enabled, self._clock.known_for, time.monotonic())

    def _stop(self, enabled: bool) -> str:
        self._link.end("stopped on request")
        return ""

    def _guide(self, enabled: bool) -> str:
        return self._at_rest(enabled) or self._adapter.guide()

    def _recover(self, enabled: bool) -> str:
        return self._at_rest(enabled) or self._adapter.recover()

    def _say_identity(self, arm: ArmState) -> None:
        self._say(IdentityDatagram(arm.q, self._adapter.identity()).pack())


def made(settings: DriverSettings, node: socket.socket) -> AdapterDriver:
    """The driver that the settings ask for.

    Raises:
        RobotRefused: There is no such adapter, or an option is wrong.
    """
    try:
        adapter = load(settings.driver)(settings.address, settings.options)
    except ModuleNotFoundError as error:
        python = ".".join(map(str, sys.version_info[:2]))
        raise RobotRefused(f"{error} in the driver's Python {python}") from error
    except (ValueError, ImportError) as error:
        raise RobotRefused(str(error)) from error
    return AdapterDriver(settings, node, adapter)


if __name__ == "__main__":
    sys.exit(serve(made, sys.argv[1:]))
