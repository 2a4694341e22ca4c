"""What the drivers of all arms share: the node's side of the socket, the link, and what it says.

A driver is a process without ROS. It is called with its settings as JSON (`DriverSettings`) and the
number of the socket that the node shares with it. Exit code 0: asked to end; 1: an error; 2: this
robot must not be driven, with the reason on stderr.
"""

from __future__ import annotations

import gc
import math
import signal
import socket
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace

from surg_hardware import driver_process, robot_clock
from surg_hardware.conditions import NOT_NUMBERS, OFFLINE, Condition, Reading
from surg_hardware.driver_datagrams import (
    LONGEST,
    REQUESTS,
    CommandDatagram,
    DatagramError,
    NoticeDatagram,
    StateDatagram,
    decode_to_driver,
)
from surg_hardware.driver_settings import DriverSettings
from surg_hardware.robot_clock import RobotClock
from surg_hardware.robot_link import (
    START_TIMEOUT,
    Command,
    LinkStep,
    RobotLink,
    RobotState,
    Settings,
    Status,
)

STALE = 0.04
"""[s] A state that is older is not sent on; without any for this time the robot is lost."""
LATE_COMMAND = 0.2
"""[s] A command that answers an older state came too late and is ignored."""
FIRST_CONNECTION, AGAIN = 5.0, 0.5
"""[s] Longest wait for the robot at the start; pause between attempts."""
LAST_RAMP = 0.5
"""[s] The arm comes to rest before the driver ends."""
IDENTITY_PERIOD = 1.0
"""[s] Between two looks at the robot's identity, at rest."""
PUBLISHED = 0.002
"""[s] Between two states for the node: the controller's cycle."""


class RobotRefused(Exception):
    """This robot must not be driven; asking again changes nothing. Says why, and the cure."""


class ArmDriver(ABC):
    """Drives one arm; `run` returns when it shall end.

    Args:
        settings: Of the driver.
        node: The socket that the node shares with it.
        cycle: Of the robot [s].
        window: Of the robot's clock [s].
        start_timeout: For the robot to obey after a start [s].
    """

    def __init__(
        self,
        settings: DriverSettings,
        node: socket.socket,
        cycle: float,
        window: float = robot_clock.WINDOW,
        start_timeout: float = START_TIMEOUT,
    ) -> None:
        self._settings, self._node = settings, node
        node.setblocking(False)
        self._link = RobotLink(
            Settings(
                settings.velocity,
                settings.acceleration,
                settings.dead_man,
                settings.stop_deceleration,
                cycle,
                start_timeout,
            )
        )
        self._clock = RobotClock(window)
        self._command: Command | None = None
        self._tick = self._cycles = 0
        self._each = max(1, round(PUBLISHED / cycle))
        self._tried = self._identified = -1e9  # our clock
        self._sent: Status | None = None
        self._warned = False
        self._ended = ""
        self._requests = {
            "start": self._start,
            "stop": self._stop,
            "guide": self._guide,
            "recover": self._recover,
        }

    def run(self) -> None:
        """Serve until `end`, or until the node has gone; the arm is then at rest.

        Raises:
            RobotRefused: This robot cannot be driven.
            TimeoutError: Nobody answers at the address.
        """
        self._connect_first()
        deadline = math.inf
        try:
            while deadline == math.inf or (self._may_move and time.monotonic() < deadline):
                self._turn()
                if self._ended and deadline == math.inf:
                    deadline = time.monotonic() + LAST_RAMP
                    self._link.end(self._ended)
        finally:
            self._close()

    def end(self, why: str) -> None:
        """Let `run` end once the arm is at rest; for signals too."""
        self._ended = self._ended or why

    # --- what each driver does in its own way ---------------------------------------------------

    @abstractmethod
    def _connect_first(self) -> None:
        """Wait for the robot; errors as those of `run`."""

    @abstractmethod
    def _turn(self) -> None:
        """Wait for the robot or the node, and answer."""

    @property
    @abstractmethod
    def _may_move(self) -> bool:
        """Whether the arm may still move by this driver."""

    @abstractmethod
    def _close(self) -> None:
        """End the connection."""

    @abstractmethod
    def _start(self, enabled: bool) -> str:
        """Let the robot obey; returns why not. ``enabled``: the controller is."""

    @abstractmethod
    def _stop(self, enabled: bool) -> str:
        """As `_start`: the robot no longer obeys."""

    @abstractmethod
    def _guide(self, enabled: bool) -> str:
        """As `_start`: let a person move the arm by hand."""

    @abstractmethod
    def _recover(self, enabled: bool) -> str:
        """As `_start`: clear the error of the robot."""

    def _at_rest(self, enabled: bool) -> str:
        """Why the arm cannot be taken as standing; empty: it stands."""
        if enabled or self._link.active:
            return "only while the controller is DISABLED and the robot is not started"
        return ""

    # --- one cycle ------------------------------------------------------------------------------

    def _step(self, state: RobotState, now: float) -> LinkStep | None:
        """The link's answer to a state; None: the state is no use."""
        if not driver_process.finite((state.time, *state.q, *state.qd)):
            self._say_lost(NOT_NUMBERS)
            return None
        if self._clock.restarted(state.time):
            self._link.lost()
            self._notice("the robot was restarted: its clock went back")
        self._taken = self._clock.arrived(state.time, now)
        warning = state.reading.condition is Condition.READY and state.reading.sentence
        if warning and not self._warned:
            self._notice(warning)
        self._warned = bool(warning)
        return self._link.step(state, self._command, now)

    def _report(self, state: RobotState, status: Status, now: float) -> None:
        """Send a state and the link's status to the node."""
        self._cycles += 1
        lasting = replace(status, last_command_ns=0)
        if self._cycles % self._each and lasting == self._sent:
            return
        self._tick += 1
        self._sent = lasting
        if now - self._taken <= STALE:
            stamp = time.time_ns() - round(1e9 * (now - self._taken))
            message = StateDatagram(stamp, self._tick, state.q, state.qd, status, state.wrench)
            self._say(message.pack())

    def _identity_is_due(self, now: float) -> bool:
        if not self._link.at_rest or now - self._identified <= IDENTITY_PERIOD:
            return False
        self._identified = now
        return True

    # --- the node -------------------------------------------------------------------------------

    def _read_node(self) -> None:
        """Take the node's newest command and its requests."""
        try:
            while True:
                data = self._node.recv(LONGEST)
                if not data:
                    self.end("the link's node has ended")
                    return
                try:
                    message = decode_to_driver(data)
                except DatagramError as error:
                    self._notice(f"from the node: {error}")
                    continue
                if isinstance(message, CommandDatagram):
                    if time.time_ns() - message.stamp_ns <= LATE_COMMAND * 1e9:
                        self._command = Command(message.qd, message.stamp_ns, time.monotonic())
                elif refusal := self._obey(message.word, message.enabled):
                    self._notice(f"{message.word}: {refusal}")
        except BlockingIOError:
            pass
        except OSError as error:
            self.end(f"the link's node: {error}")

    def _obey(self, word: str, enabled: bool) -> str:
        """Obey a request; returns why not, or nothing."""
        if word not in self._requests:
            return f"is unknown; allowed: {', '.join(REQUESTS)}"
        return self._requests[word](enabled)

    def _say_lost(self, reading: Reading = OFFLINE) -> None:
        """Tell the node, on change, that no state comes, or none that is of use."""
        status = replace(self._link.lost(reading), last_command_ns=0)
        if status != self._sent:
            self._say(StateDatagram(0, self._tick, (), (), status).pack())
        self._sent = status

    def _notice(self, text: str) -> None:
        self._say(NoticeDatagram(text).pack())

    def _say(self, data: bytes) -> None:
        """Send to the node; one that does not read misses it."""
        try:
            self._node.send(data)
        except BlockingIOError:
            pass
        except OSError as error:
            self.end(f"the link's node: {error}")


def serve(
    made: Callable[[DriverSettings, socket.socket], ArmDriver], arguments: Sequence[str]
) -> int:
    """Entry point of a driver's process; returns the exit code.

    Args:
        made: Makes the driver.
        arguments: Settings as JSON, number of the node's socket.
    """
    settings = DriverSettings.from_json(arguments[0])
    node = socket.socket(fileno=int(arguments[1]))
    try:
        with driver_process.alone(settings.address):
            driver = made(settings, node)
            for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
                signal.signal(number, lambda *_: driver.end("the driver was asked to end"))
            driver_process.die_with_parent()
            driver_process.realtime(settings.realtime, settings.address)
            gc.freeze()
            gc.disable()  # the loop makes no cycles, and a collection would be late
            driver.run()
    except (driver_process.NotHere, RobotRefused, TimeoutError) as error:
        print(f"{settings.address}: {error}", file=sys.stderr, flush=True)
        return 2
    return 0
