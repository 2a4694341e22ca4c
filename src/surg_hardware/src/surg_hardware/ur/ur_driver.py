"""The process that drives one UR arm: a loop on the robot's own cycle, without ROS.

``python3 -m surg_hardware.ur.ur_driver SETTINGS FD``, see `arm_driver`.
"""

from __future__ import annotations

import select
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from surg_hardware.arm_driver import (
    AGAIN,
    FIRST_CONNECTION,
    STALE,
    ArmDriver,
    RobotRefused,
    serve,
)
from surg_hardware.conditions import OFFLINE, Condition, Reading
from surg_hardware.driver_datagrams import IdentityDatagram
from surg_hardware.driver_settings import DriverSettings
from surg_hardware.robot_link import CommandPhase
from surg_hardware.ur import orders, primary, urscript
from surg_hardware.ur.orders import ANSWER, LOCAL, Order, Orders
from surg_hardware.ur.rtde import Rtde, RtdeError, RtdeRefused, Values
from surg_hardware.ur.ur_states import SetValues, arm_identity, robot_state, says_guiding

CYCLE = 0.002
"""[s] Of an e-Series."""
WAIT = 0.02
"""[s] Longest wait for a packet."""
SILENCE = 1.0
"""[s] Without a packet, after which the connection is given up."""
START = ANSWER + 2.0
"""[s] For the robot to obey after a start: it may take its time to answer."""
ASKING = "the robot has not answered the last request yet: wait"


@dataclass(frozen=True)
class Connected:
    """What one connection has found; ``rtde`` is open, and its reader closes it."""

    rtde: Rtde
    orders: Orders
    serial: str
    model: str


def connect(address: str) -> Connected:
    """Connect; may take seconds.

    Raises:
        OSError: The robot does not answer.
        RtdeRefused: It cannot be driven: its version, a missing field, another client.
    """
    robot = orders.of(address)
    serial, model = robot.identity()
    return Connected(Rtde(address), robot, serial, model)


class UrDriver(ArmDriver):
    """Drives one arm; `run` returns when it shall end."""

    def __init__(self, settings: DriverSettings, node: socket.socket) -> None:
        super().__init__(settings, node, CYCLE, start_timeout=START)
        self._phase = CommandPhase(CYCLE)
        self._rtde: Rtde | None = None
        self._offline = OFFLINE  # why there is no connection
        self._set = SetValues()
        self._program = self._guiding = False  # whether any program runs on the robot; hand guiding
        self._starting = False  # uploaded, and not seen to run
        self._robot: Connected | None = None  # the last connection
        self._arrived = self._ended_program = -1e9  # our clock
        self._asking = self._cancelled = self._connecting = False
        self._answers: deque[Callable[[], None]] = deque()  # of threads, for the loop to take

    # --- the loop -------------------------------------------------------------------------------

    @property
    def _may_move(self) -> bool:
        return self._link.active

    def _close(self) -> None:
        # Without new commands the robot's own program stops the arm.
        if self._rtde is not None:
            self._rtde.close()

    def _turn(self) -> None:
        """Wait for the robot or the node, and answer."""
        sources: list[Rtde | socket.socket] = [self._node]
        if self._rtde is not None:
            sources.append(self._rtde)
        select.select(sources, (), (), WAIT)
        self._read_node()
        while self._answers:
            self._answers.popleft()()
        now = time.monotonic()
        if self._rtde is None:
            if now - self._tried > AGAIN and not self._connecting:
                self._connect_again()
            self._say_lost(self._offline)
            return
        try:
            values = self._rtde.newest()
            if values is not None:
                self._arrived = now
                self._await_command(now)
                self._cycle(self._rtde, values, now)
            elif now - self._arrived > SILENCE:
                raise RtdeError(f"no state for {SILENCE:g} s")
            elif now - self._arrived > STALE:
                self._say_lost()
        except OSError as error:
            self._disconnect(str(error))

    def _await_command(self, now: float) -> None:
        """Wait for a command that comes just after the state."""
        if self._command is None or not self._link.active:
            return
        wait = self._phase.wait(now - self._command.received)
        if wait > 0 and select.select((self._node,), (), (), wait)[0]:
            self._read_node()

    def _cycle(self, rtde: Rtde, values: Values, now: float) -> None:
        """Answer one state of the robot."""
        self._starting = self._starting and says_guiding(values)
        state = robot_state(values, self._starting)
        self._program = state.program or state.paused
        self._guiding = state.program and says_guiding(values)
        if self._link.active and (change := self._set.change(values)):
            self._link.end(change)
        step = self._step(state, now)
        if step is None:
            return
        if step.qd is not None:
            rtde.send(step.number, step.qd)
        self._report(state, step.status, now)
        if step.end_program and now - self._ended_program > AGAIN:
            self._ended_program = now
            self._beside(self._end_program)
        if self._identity_is_due(now):
            self._say_identity(values)
        for text in rtde.messages:
            self._notice(f"the robot says: {text}")
        rtde.messages.clear()

    # --- the connection -------------------------------------------------------------------------

    def _take(self, robot: Connected) -> None:
        self._rtde, self._robot = robot.rtde, robot
        self._connecting, self._offline = False, OFFLINE
        self._clock.reset()
        self._arrived, self._identified = time.monotonic(), -1e9

    def _connect_first(self) -> None:
        deadline = time.monotonic() + FIRST_CONNECTION
        while not self._ended:
            try:
                self._take(connect(self._settings.address))
                return
            except RtdeRefused as error:
                raise RobotRefused(str(error)) from error
            except OSError as error:
                if time.monotonic() > deadline:
                    raise TimeoutError(f"hardware.address: {error}") from error
                time.sleep(0.1)

    def _connect_again(self) -> None:
        self._connecting, self._tried = True, time.monotonic()

        def work() -> None:
            try:
                found = connect(self._settings.address)
            except OSError as error:
                why = error
                self._answers.append(lambda: self._fail(why))
            else:
                self._answers.append(lambda: self._take(found))

        self._beside(work)

    def _fail(self, error: OSError) -> None:
        """Say why there is no connection: the robot may answer, and refuse."""
        self._connecting, said = False, self._offline
        self._offline = OFFLINE
        if isinstance(error, RtdeRefused):
            self._offline = Reading(Condition.OFFLINE, error.sentence, error.cure)
        if self._offline != said:
            self._notice(str(error))

    def _disconnect(self, why: str) -> None:
        if self._rtde is not None:
            self._rtde.close()
            self._rtde = None
        self._notice(f"the connection to the robot has ended: {why}")
        self._say_lost()

    # --- requests of the node -------------------------------------------------------------------

    def _obey(self, word: str, enabled: bool) -> str:
        if self._rtde is None:
            return self._offline.text
        return super()._obey(word, enabled)

    def _beside(self, work: Callable[[], None]) -> None:
        """Work beside the loop: the robot may take its time to answer."""
        threading.Thread(target=work, daemon=True).start()

    def _start(self, enabled: bool) -> str:
        if self._asking:
            return ASKING
        if self._program and not self._link.active:
            return "a program runs on the robot, such as hand guiding: ./surg robot CELL stop"
        refusal = self._link.start(enabled, self._clock.known_for, time.monotonic())
        if refusal:
            return refusal
        self._starting = True
        program = urscript.follow_program(self._settings.stop_deceleration)
        self._upload("start", program, lambda: self._program, wanted=lambda: self._link.active)
        return ""

    def _guide(self, enabled: bool) -> str:
        if self._asking:
            return ASKING
        if refusal := self._at_rest(enabled):
            return refusal
        self._starting = False
        self._upload("guide", urscript.guide_program(), lambda: self._guiding)
        return ""

    def _stop(self, enabled: bool) -> str:
        self._cancelled = True
        if self._link.active:
            self._link.end("stopped on request")
        elif self._program or self._asking:
            self._beside(self._end_program)
        return ""

    def _end_program(self) -> None:
        """End the program on the robot: `play` would give a paused arm its old speed back."""
        assert self._robot is not None
        try:
            refusal = self._robot.orders.order(Order.STOP)
        except OSError as error:
            refusal = str(error)
        if refusal:
            self._notice(f"stop: a program is still on the robot: stop it there ({refusal})")

    def _upload(
        self,
        word: str,
        program: str,
        started: Callable[[], bool],
        wanted: Callable[[], bool] = lambda: True,
    ) -> None:
        """Start a program beside the loop, as long as it is wanted and nobody says stop."""
        self._asking, self._cancelled = True, False
        assert self._robot is not None
        robot = self._robot.orders

        def still() -> bool:
            return wanted() and not self._cancelled

        def ask() -> None:
            refusal = ""
            try:
                if robot.remote():
                    primary.upload(self._settings.address, program, started, still)
                else:
                    refusal = LOCAL
            except OSError as error:
                refusal = f"the robot does not answer its ports for orders and programs: {error}"
            self._answers.append(lambda: self._uploaded(word, refusal))

        self._beside(ask)

    def _uploaded(self, word: str, refusal: str) -> None:
        self._asking = False
        if refusal:
            self._link.end(refusal)
            self._notice(f"{word}: {refusal}")

    def _recover(self, enabled: bool) -> str:
        return "a person is asked first: ./surg robot CELL recover"

    def _say_identity(self, values: Values) -> None:
        assert self._robot is not None
        self._set.know(values)
        found = arm_identity(values, self._robot.serial, self._robot.model)
        self._say(IdentityDatagram(values["actual_q"], found).pack())


if __name__ == "__main__":
    sys.exit(serve(UrDriver, sys.argv[1:]))
