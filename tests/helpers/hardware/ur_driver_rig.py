"""A UR driver between the node's side of its socket and an emulated arm, all in real time."""

from __future__ import annotations

import contextlib
import json
import math
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

from helpers.hardware import emulated_ur
from surg_hardware.conditions import Condition
from surg_hardware.driver_datagrams import (
    LONGEST,
    CommandDatagram,
    NoticeDatagram,
    RequestDatagram,
    StateDatagram,
    decode_from_driver,
)
from surg_hardware.driver_settings import DriverSettings
from surg_hardware.ur.ur_driver import UrDriver

DEAD_MAN, STOP = 0.04, 20.0
SENDING = 50
"""Priority of the sending thread, where it is granted."""


def driver(
    address: str, node: socket.socket, errors: int | None = None, **env: str
) -> subprocess.Popen[str]:
    """Start the driver of an arm; closes its end of the socket here.

    Args:
        address: Of the arm.
        node: What the driver shares with the node.
        errors: Where its standard error goes, as `subprocess.Popen` takes it.
        env: Added to its environment.
    """
    settings = DriverSettings(address, 40, (math.pi,) * 6, (40.0,) * 6, DEAD_MAN, STOP)
    words = [json.dumps(asdict(settings)), str(node.fileno())]
    path = f"{emulated_ur.SOURCES}:{os.environ['PYTHONPATH']}"
    with node:
        return subprocess.Popen(
            [sys.executable, "-s", "-m", "surg_hardware.ur.ur_driver", *words],
            pass_fds=(node.fileno(),),
            env={**os.environ, "PYTHONPATH": path, **env},
            stderr=errors,
            text=True,
        )


class Rig:
    """The node's side of the driver's socket: sends a command for each state.

    Args:
        address: Of the emulated arm.
    """

    def __init__(self, address: str) -> None:
        self.address = address
        self.state: StateDatagram | None = None
        self.notices: list[str] = []
        self._ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.driver = driver(address, theirs)
        self._ours.settimeout(0.05)
        self._closing = False
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def condition(self) -> Condition:
        """What the driver says of the robot."""
        return Condition.OFFLINE if self.state is None else self.state.status.condition

    def wait(self, wanted: Condition, seconds: float = 8.0) -> None:
        """Wait for a condition."""
        end = time.monotonic() + seconds
        while self.condition() is not wanted:
            said = self.state.status.fault if self.state else "nothing"
            assert time.monotonic() < end, f"{self.condition()!r}: {said}; {self.notices}"
            time.sleep(0.01)

    def start(self) -> None:
        """Start the robot; it is refused until states have come for 2 s."""
        self.wait(Condition.READY)
        end = time.monotonic() + 6.0
        while self.condition() is not Condition.ACTIVE:
            assert time.monotonic() < end, self.notices
            self.request("start")
            time.sleep(0.3)

    def request(self, word: str, enabled: bool = False) -> None:
        """Ask the driver for something; `enabled`: what it is told of the controller."""
        self._ours.send(RequestDatagram(word, enabled).pack())

    def fault(self, line: str) -> float:
        """Let a fault happen; when (monotonic) [s]."""
        when = time.monotonic()
        assert emulated_ur.fault(self.address, line) == "ok"
        return when

    def leave(self) -> None:
        """End the node's side of the socket, as when the node is killed."""
        with contextlib.suppress(OSError):
            self._ours.shutdown(socket.SHUT_RDWR)
        with contextlib.suppress(OSError):
            self._ours.close()

    def close(self) -> None:
        """End driver and thread."""
        self._closing = True
        self.leave()
        self._thread.join(2.0)
        self.driver.terminate()
        self.driver.send_signal(signal.SIGCONT)
        self.driver.wait(5.0)

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            os.sched_setscheduler(threading.get_native_id(), os.SCHED_FIFO, os.sched_param(SENDING))
        while not self._closing:
            try:
                data = self._ours.recv(LONGEST)
            except TimeoutError:
                continue
            except OSError:
                return
            if not data:
                return
            self._take(decode_from_driver(data))

    def _take(self, message: object) -> None:
        if isinstance(message, NoticeDatagram):
            self.notices.append(message.text)
        if not isinstance(message, StateDatagram):
            return
        self.state = message
        if message.q:
            with contextlib.suppress(OSError):
                self._ours.send(CommandDatagram(time.time_ns(), (0.0,) * 6).pack())


@contextmanager
def rig(folder: Path) -> Iterator[Rig]:
    """An emulated arm with its driver; yields the node's side."""
    with emulated_ur.program(folder / "emulator.log") as address:
        made = Rig(address)
        try:
            yield made
        finally:
            made.close()


def settings_of(address: str) -> DriverSettings:
    """Of a driver in this process, which must not take a priority."""
    return DriverSettings(address, 0, (1.0,) * 6, (40.0,) * 6, DEAD_MAN, STOP)


class DriverThread:
    """A driver in a thread of this process; decided by what it says, never by the clock.

    Attributes:
        notices: The driver's sentences.
    """

    def __init__(self, address: str) -> None:
        self._ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._ours.settimeout(60.0)
        self.notices: list[str] = []
        self._driver = UrDriver(settings_of(address), theirs)
        self._thread = threading.Thread(target=self._driver.run, daemon=True)
        self._thread.start()

    def until(self, wanted: Callable[[Condition], bool], word: str = "") -> None:
        """Hear states until one is wanted, with a request now and then."""
        count = 0
        while True:
            message = decode_from_driver(self._ours.recv(LONGEST))
            if isinstance(message, NoticeDatagram):
                self.notices.append(message.text)
            elif isinstance(message, StateDatagram):
                if wanted(message.status.condition):
                    return
                count += 1
                if word and count % 50 == 1:
                    self._ours.send(RequestDatagram(word, False).pack())

    def end(self) -> None:
        """End the driver, which must not hang."""
        self._driver.end("the test is over")
        self._thread.join(60.0)
        assert not self._thread.is_alive()
