"""A UR driver between a motion through a trocar and an emulated arm, all in real time.

The motion is computed ahead from the emulator's own kinematics: the shaft of a 0.3 m tool turns
about a fixed pivot. Nothing corrects the arm on its way; what it does is read from the emulator's
record.
"""

from __future__ import annotations

import contextlib
import csv
import functools
import json
import math
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from helpers.hardware import emulated_ur
from surg_emulators.ur import dh_kinematics as dh
from surg_emulators.ur.joint_motion import DT
from surg_emulators.ur.ur_controller import HOME
from surg_hardware.arm_driver import DriverSettings
from surg_hardware.conditions import Condition
from surg_hardware.driver_datagrams import (
    LONGEST,
    CommandDatagram,
    NoticeDatagram,
    RequestDatagram,
    StateDatagram,
    decode_from_driver,
)

Matrix = NDArray[np.float64]
TABLE = dh.TABLES["UR5e"]
SHAFT, DEPTH = 0.3, 0.12
"""From flange to tip; from pivot to tip [m]."""
BEGIN = 1.0
"""The motion reaches its speed within this time [s]."""
SWEEP = 0.6
"""Largest angle of the shaft from its home [rad]."""
RESTING = 0.002
"""A joint below this speed stands still [rad/s]."""
SETTLED = 50
"""Cycles after which a standing arm has reached its target."""
DEAD_MAN, STOP = 0.04, 20.0
SENDING = 50
"""Priority of the sending thread, where it is granted."""


@functools.cache
def plan(speed: float, seconds: float) -> Matrix:
    """Joint velocities of a motion about the pivot, one row per cycle [rad/s].

    Args:
        speed: Largest speed of the tip [m/s].
        seconds: How long.
    """
    tool = np.eye(4)
    tool[2, 3] = SHAFT
    X_home = dh.frames(HOME, TABLE)[-1] @ tool
    pivot = X_home[:3, 3] - DEPTH * X_home[:3, 2]
    rate = speed / DEPTH
    sweep = min(SWEEP, max(0.05, 0.25 * rate))
    omega = rate / sweep
    q, rows = list(HOME), []
    for t in np.arange(1, round(seconds / DT) + 1) * DT:
        share = min(t / BEGIN, 1.0)
        ease = share * share * (3.0 - 2.0 * share)
        angle = ease * sweep * math.sin(omega * t)
        R = dh.rotation_matrix(angle * X_home[:3, 0])
        X = np.eye(4)
        X[:3, :3] = R @ X_home[:3, :3]
        X[:3, 3] = pivot + DEPTH * X[:3, 2]
        found = dh.inverse(X, q, TABLE, tool)
        assert found is not None
        rows.append([(b - a) / DT for a, b in zip(q, found, strict=True)])
        q = found
    return np.array(rows)


@dataclass(frozen=True)
class Record:
    """What the emulator wrote: one row per cycle."""

    clock: Matrix  # (n,) monotonic [s]
    safety: Matrix  # (n,)
    q: Matrix  # (n, 6) [rad]

    @staticmethod
    def read(file: Path) -> Record:
        """Read the file; a last row that is not complete does not count."""
        with file.open() as lines:
            rows = [row for row in csv.DictReader(lines) if row["target_qd6"]]
        return Record(
            np.array([float(row["monotonic"]) for row in rows]),
            np.array([float(row["safety_mode"]) for row in rows]),
            np.array([[float(row[f"q{joint}"]) for joint in range(1, 7)] for row in rows]),
        )

    def deviation(self) -> Matrix:
        """Distance of the shaft from the pivot [m], (n,)."""
        home = dh.frames(HOME, TABLE)[-1]
        pivot = home[:3, 3] + (SHAFT - DEPTH) * home[:3, 2]
        found = []
        for q in self.q:
            X = dh.frames(list(q), TABLE)[-1]
            away = pivot - X[:3, 3]
            found.append(np.linalg.norm(away - (away @ X[:3, 2]) * X[:3, 2]))
        return np.array(found)

    def tip(self) -> Matrix:
        """Positions of the tip [m], (n, 3)."""
        poses = (dh.frames(list(q), TABLE)[-1] for q in self.q)
        return np.array([X[:3, 3] + SHAFT * X[:3, 2] for X in poses])


@dataclass(frozen=True)
class Stop:
    """How an arm came to rest."""

    to_rest: float  # from the event [s]
    way: float  # of the tip meanwhile [m]
    before: float  # largest deviation from the pivot before the event [m]
    off: float  # and after it
    later: float  # what the joints moved after that [rad]

    @staticmethod
    def after(record: Record, event: float, end: float) -> Stop:
        """Read a stop from a record.

        Args:
            record: The record.
            event: When it began (monotonic) [s].
            end: What is judged ends here.
        """
        first = int(np.searchsorted(record.clock, event))
        last = int(np.searchsorted(record.clock, end))
        speed = np.abs(np.diff(record.q, axis=0)).max(axis=1) / DT
        moving = np.flatnonzero(speed[first:last] > RESTING)
        rest = first + (int(moving[-1]) + 1 if moving.size else 0)
        tip, deviation = record.tip(), record.deviation()
        # The first time that the arm stands for 20 ms is the stop. The joints still creep to their
        # targets; after that nothing must move.
        still = next((n for n in range(first, last) if (speed[n : n + 10] <= RESTING).all()), rest)
        settled = min(still + SETTLED, last - 1)
        return Stop(
            float(record.clock[still] - event),
            float(np.linalg.norm(np.diff(tip[first : still + 1], axis=0), axis=1).sum()),
            float(deviation[:first].max()),
            float(deviation[first:last].max()),
            float(np.abs(record.q[settled:last] - record.q[settled]).max()),
        )


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
        self.heard: list[tuple[float, StateDatagram]] = []
        """Every change of the status, with our time [s]."""
        self.ages: list[float] = []
        """Age of the newest command that the robot obeys, at every state [s]."""
        self.sending = True
        self._rows: Matrix | None = None
        self._row = 0
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

    def move(self, rows: Matrix, seconds: float) -> None:
        """Send the rows, one per state; returns while it moves."""
        self._row, self._rows = 0, rows
        end = time.monotonic() + 3.0 * seconds
        while self._row < seconds / DT:
            assert time.monotonic() < end, f"{self._row} rows"
            assert self.condition() is Condition.ACTIVE, self.notices
            time.sleep(0.002)

    def fault(self, line: str) -> float:
        """Let a fault happen; when (monotonic) [s]."""
        when = time.monotonic()
        assert emulated_ur.fault(self.address, line) == "ok"
        return when

    def kill(self, number: int) -> float:
        """Send a signal to the driver; when (monotonic) [s]."""
        when = time.monotonic()
        os.kill(self.driver.pid, number)
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
        if self.state is None or message.status.condition != self.state.status.condition:
            self.heard.append((time.monotonic(), message))
        self.state = message
        if message.status.last_command_ns:
            self.ages.append(1e-9 * (time.time_ns() - message.status.last_command_ns))
        if not self.sending or not message.q:
            return
        qd = (0.0,) * 6
        if self._rows is not None:
            qd = tuple(float(each) for each in self._rows[min(self._row, len(self._rows) - 1)])
            self._row += 1
        with contextlib.suppress(OSError):
            self._ours.send(CommandDatagram(time.time_ns(), qd).pack())


@contextmanager
def rig(folder: Path) -> Iterator[tuple[Rig, Path]]:
    """An emulated arm with its driver; yields the node's side and the emulator's record."""
    record = folder / "record.csv"
    with emulated_ur.program(folder / "emulator.log", "--record", str(record)) as address:
        made = Rig(address)
        try:
            yield made, record
        finally:
            made.close()
