"""The process that drives one UR arm: a loop on the robot's own cycle, without ROS.

``python3 -m surg_hardware.ur.ur_driver SETTINGS FD``, see `arm_driver`.
"""

from __future__ import annotations

import select
import socket
import sys
import threading
import time

from surg_hardware.arm_driver import (
    AGAIN,
    FIRST_CONNECTION,
    STALE,
    ArmDriver,
    DriverSettings,
    RobotRefused,
    serve,
)
from surg_hardware.conditions import OFFLINE, ur_reading
from surg_hardware.driver_datagrams import IdentityDatagram
from surg_hardware.identity import ur_flange, ur_wrench
from surg_hardware.robot_link import CommandPhase, RobotState
from surg_hardware.ur import dashboard, urscript
from surg_hardware.ur.rtde import Rtde, RtdeError, RtdeRefused, Values

CYCLE = 0.002
"""[s] Of an e-Series."""
WAIT = 0.02
"""[s] Longest wait for a packet."""
SILENCE = 1.0
"""[s] Without a packet, after which the connection is given up."""
_PLAYING = 2
_PAUSED = (3, 4)  # pausing, paused
_TEACH_BUTTON = 4  # bit of robot_status_bits


def robot_state(values: Values, starting: bool = False) -> RobotState:
    """What a state of RTDE means to the link.

    ``starting``: the link's own program has been uploaded. Registers outlive a program, so that of
    hand guiding means nothing until the new program has written it.
    """
    playing = values["runtime_state"][0] == _PLAYING
    guided = bool(int(values["robot_status_bits"][0]) & _TEACH_BUTTON) or (
        playing and not starting and _says_guiding(values)
    )
    return RobotState(
        time=values["timestamp"][0],
        q=values["actual_q"],
        qd=values["actual_qd"],
        reading=ur_reading(
            int(values["robot_mode"][0]),
            int(values["safety_status"][0]),
            values["speed_scaling"][0] * values["target_speed_fraction"][0],
            guided,
        ),
        program=playing,
        paused=values["runtime_state"][0] in _PAUSED,
        executed=int(values["output_int_register_24"][0]),
        ahead=tuple(b - a for a, b in zip(values["actual_q"], values["target_q"], strict=True)),
        wrench=ur_wrench(values["actual_TCP_force"]),
    )


def _says_guiding(values: Values) -> bool:
    return bool(values["output_int_register_25"][0] == urscript.GUIDING)


class UrDriver(ArmDriver):
    """Drives one arm; `run` returns when it shall end."""

    def __init__(self, settings: DriverSettings, node: socket.socket) -> None:
        super().__init__(settings, node, CYCLE)
        self._phase = CommandPhase(CYCLE)
        self._rtde: Rtde | None = None
        self._program = False  # whether any program runs on the robot
        self._starting = False  # uploaded, and not seen to run
        self._serial = self._model = ""
        self._arrived = self._ended_program = -1e9  # our clock

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
        now = time.monotonic()
        if self._rtde is None:
            if now - self._tried > AGAIN:
                self._connect_again()
            self._say_lost()
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
        self._starting = self._starting and _says_guiding(values)
        state = robot_state(values, self._starting)
        self._program = state.program
        step = self._step(state, now)
        if step is None:
            return
        if step.qd is not None:
            rtde.send(step.number, step.qd)
        self._report(state, step.status, now)
        if step.end_program and now - self._ended_program > AGAIN:
            self._ended_program = now
            # Beside the loop: the dashboard may take its time.
            threading.Thread(target=self._end_program, daemon=True).start()
        if self._identity_is_due(now):
            self._say_identity(values)
        for text in rtde.messages:
            self._notice(f"the robot says: {text}")
        rtde.messages.clear()

    # --- the connection -------------------------------------------------------------------------

    def _connect(self) -> None:
        self._tried = time.monotonic()
        questions = ("get serial number", "get robot model")
        self._serial, self._model = dashboard.ask(self._settings.address, questions)
        rtde = Rtde(self._settings.address)
        if cure := dashboard.age_cure(rtde.version):
            rtde.close()
            version = ".".join(map(str, rtde.version))
            raise RtdeRefused(f"the controller's version {version} is too old: {cure}")
        self._rtde = rtde
        self._clock.reset()
        self._arrived, self._identified = time.monotonic(), -1e9

    def _connect_first(self) -> None:
        deadline = time.monotonic() + FIRST_CONNECTION
        while not self._ended:
            try:
                self._connect()
                return
            except RtdeRefused as error:
                raise RobotRefused(str(error)) from error
            except OSError as error:
                if time.monotonic() > deadline:
                    raise TimeoutError(f"hardware.address: {error}") from error
                time.sleep(0.1)

    def _connect_again(self) -> None:
        try:
            self._connect()
        except OSError as error:
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
            return OFFLINE.text
        try:
            return super()._obey(word, enabled)
        except OSError as error:
            self._link.end(f"the robot could not be asked: {error}")
            return f"the robot does not answer its dashboard or script port: {error}"

    def _start(self, enabled: bool) -> str:
        if self._program and not self._link.active:
            return "a program runs on the robot, such as hand guiding: ./surg robot CELL stop"
        refusal = self._link.start(enabled, self._clock.known_for, time.monotonic())
        if refusal:
            return refusal
        self._starting = True
        return self._upload(urscript.follow_program(self._settings.stop_deceleration))

    def _guide(self, enabled: bool) -> str:
        if refusal := self._at_rest(enabled):
            return refusal
        self._starting = False
        return self._upload(urscript.guide_program())

    def _stop(self, enabled: bool) -> str:
        if self._link.active:
            self._link.end("stopped on request")
        elif self._program:
            dashboard.ask(self._settings.address, ("stop",))
        return ""

    def _end_program(self) -> None:
        """End the paused program: `play` would give the arm its old speed back."""
        try:
            (answer,) = dashboard.ask(self._settings.address, ("stop",))
        except OSError as error:
            answer = str(error)
        if not answer.startswith("Stopped"):
            self._notice(f"a paused program is still on the robot: stop it there ({answer})")

    def _upload(self, program: str) -> str:
        (remote,) = dashboard.ask(self._settings.address, ("is in remote control",))
        if remote.lower() != "true":
            self._link.end("the robot is in local control")
            return "the robot is in local control: switch it to remote control on the pendant"
        dashboard.upload(self._settings.address, program)
        return ""

    def _recover(self, enabled: bool) -> str:
        return "a UR is unlocked on its pendant"

    def _say_identity(self, values: Values) -> None:
        x, y, z = values["payload_cog"]
        flange = ur_flange(values["actual_TCP_pose"], values["tcp_offset"])
        self._say(
            IdentityDatagram(
                values["actual_q"],
                tuple(flange[:3].ravel().tolist()),
                values["payload"][0],
                (x, y, z),
                self._serial,
                self._model,
            ).pack()
        )


if __name__ == "__main__":
    sys.exit(serve(UrDriver, sys.argv[1:]))
