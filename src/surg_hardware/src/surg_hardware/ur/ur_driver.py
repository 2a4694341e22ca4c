"""The process that drives one UR arm: a loop on the robot's own cycle, without ROS.

``python3 -m surg_hardware.ur.ur_driver SETTINGS FD``: settings as JSON (`DriverSettings`), and the
number of the socket that the node shares with it. Exit code 0: asked to end; 1: the node has gone,
or an error; 2: this robot must not be driven, with the reason on stderr.
"""

from __future__ import annotations

import gc
import json
import math
import select
import signal
import socket
import sys
import threading
import time
from dataclasses import dataclass

from surg_hardware import driver_process
from surg_hardware.conditions import OFFLINE, ur_reading
from surg_hardware.driver_datagrams import (
    LONGEST,
    REQUESTS,
    CommandDatagram,
    DatagramError,
    IdentityDatagram,
    NoticeDatagram,
    StateDatagram,
    decode_to_driver,
)
from surg_hardware.robot_clock import RobotClock
from surg_hardware.robot_link import Command, CommandPhase, RobotLink, RobotState, Settings, Status
from surg_hardware.ur import dashboard, urscript
from surg_hardware.ur.rtde import Rtde, RtdeError, RtdeRefused, Values

JOINTS = 6
STALE = 0.04
"""[s] A state that is older is not sent on; without any for this time the robot is lost."""
LATE_COMMAND = 0.2
"""[s] A command that answers an older state came too late and is ignored."""
WAIT = 0.02
"""[s] Longest wait for a packet."""
FIRST_CONNECTION, AGAIN, SILENCE = 5.0, 0.5, 1.0
"""[s] Longest wait for the robot at the start; pause between attempts; silence that ends one."""
LAST_RAMP = 0.5
"""[s] The arm comes to rest before the driver ends."""
IDENTITY_PERIOD = 1.0
"""[s] Between two looks at the robot's identity, at rest."""
_PLAYING = 2
_PAUSED = (3, 4)  # pausing, paused
_TEACH_BUTTON = 4  # bit of robot_status_bits


@dataclass(frozen=True)
class DriverSettings:
    """Of one driver; ``realtime`` is the priority, ``link`` as in `robot_link.Settings`."""

    address: str
    realtime: int
    velocity: tuple[float, ...]
    acceleration: tuple[float, ...]
    dead_man: float
    stop_deceleration: float

    @staticmethod
    def from_json(text: str) -> DriverSettings:
        """Read what `json.dumps` of the fields has written."""
        given = json.loads(text)
        given["velocity"] = tuple(given["velocity"])
        given["acceleration"] = tuple(given["acceleration"])
        return DriverSettings(**given)


def robot_state(values: Values) -> RobotState:
    """What a state of RTDE means to the link."""
    playing = values["runtime_state"][0] == _PLAYING
    guided = bool(int(values["robot_status_bits"][0]) & _TEACH_BUTTON) or (
        playing and values["output_int_register_25"][0] == urscript.GUIDING
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
    )


class UrDriver:
    """Drives one arm; `run` returns when it shall end."""

    def __init__(self, settings: DriverSettings, node: socket.socket) -> None:
        self._settings, self._node = settings, node
        node.setblocking(False)
        self._link = RobotLink(
            Settings(
                settings.velocity,
                settings.acceleration,
                settings.dead_man,
                settings.stop_deceleration,
            )
        )
        self._clock = RobotClock()
        self._phase = CommandPhase()
        self._rtde: Rtde | None = None
        self._command: Command | None = None
        self._program = False  # whether any program runs on the robot
        self._serial = self._model = ""
        self._tick = 0
        self._arrived = self._tried = self._identified = -1e9  # our clock
        self._ended_program = -1e9
        self._sent: Status | None = None
        self._ended = ""

    def end(self, why: str) -> None:
        """Let `run` end once the arm is at rest; for signals too."""
        self._ended = self._ended or why

    # --- the loop -------------------------------------------------------------------------------

    def run(self) -> None:
        """Serve until `end`, or until the node has gone.

        Raises:
            RtdeRefused: This robot cannot be driven.
            TimeoutError: Nobody answers at the address.
        """
        self._connect_first()
        deadline = math.inf
        try:
            while deadline == math.inf or (self._link.active and time.monotonic() < deadline):
                self._turn()
                if self._ended and deadline == math.inf:
                    deadline = time.monotonic() + LAST_RAMP
                    self._link.end(self._ended)
        finally:
            # Whatever has happened: without new commands the robot's own program stops the arm.
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
        state = robot_state(values)
        self._program = state.program
        if not driver_process.finite((state.time, *state.q, *state.qd)):
            self._say_lost()
            return
        if self._clock.restarted(state.time):
            self._link.lost()
            self._notice("the robot was restarted: its clock went back")
        taken = self._clock.arrived(state.time, now)
        step = self._link.step(state, self._command, now)
        if step.qd is not None:
            rtde.send(step.number, step.qd)
        self._tick += 1
        self._sent = step.status
        if now - taken <= STALE:
            stamp = time.time_ns() - round(1e9 * (now - taken))
            self._say(StateDatagram(stamp, self._tick, state.q, state.qd, step.status).pack())
        if step.end_program and now - self._ended_program > AGAIN:
            self._ended_program = now
            # Beside the loop: the dashboard may take its time.
            threading.Thread(target=self._end_program, daemon=True).start()
        if self._link.at_rest and now - self._identified > IDENTITY_PERIOD:
            self._identified = now
            self._say_identity(values)
        for text in rtde.messages:
            self._notice(f"the robot says: {text}")
        rtde.messages.clear()

    # --- the connection -------------------------------------------------------------------------

    def _connect(self) -> None:
        self._tried = time.monotonic()
        questions = ("get serial number", "get robot model")
        self._serial, self._model = dashboard.ask(self._settings.address, questions)
        self._rtde = Rtde(self._settings.address)
        self._clock.reset()
        self._arrived, self._identified = time.monotonic(), -1e9

    def _connect_first(self) -> None:
        deadline = time.monotonic() + FIRST_CONNECTION
        while not self._ended:
            try:
                self._connect()
                return
            except RtdeRefused:
                raise
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
        if word not in REQUESTS:
            return f"is unknown; allowed: {', '.join(REQUESTS)}"
        if self._rtde is None:
            return OFFLINE.text
        try:
            return {"start": self._start, "stop": self._stop, "guide": self._guide}[word](enabled)
        except OSError as error:
            self._link.end(f"the robot could not be asked: {error}")
            return f"the robot does not answer its dashboard or script port: {error}"

    def _start(self, enabled: bool) -> str:
        if self._program and not self._link.active:
            return "a program runs on the robot: stop it on the pendant"
        refusal = self._link.start(enabled, self._clock.known_for, time.monotonic())
        if refusal:
            return refusal
        return self._upload(urscript.follow_program(self._settings.stop_deceleration))

    def _guide(self, enabled: bool) -> str:
        if enabled or self._link.active:
            return "only while the controller is DISABLED and the robot is not started"
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

    def _say_lost(self) -> None:
        """Tell the node, on change, that no state comes."""
        status = self._link.lost()
        if status != self._sent:
            self._say(StateDatagram(0, self._tick, (), (), status).pack())
        self._sent = status

    def _say_identity(self, values: Values) -> None:
        x, y, z = values["payload_cog"]
        self._say(
            IdentityDatagram(
                values["actual_q"],
                values["actual_TCP_pose"],
                values["tcp_offset"],
                values["payload"][0],
                (x, y, z),
                self._serial,
                self._model,
            ).pack()
        )

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


def main(arguments: list[str]) -> int:
    """Entry point; returns the exit code."""
    settings = DriverSettings.from_json(arguments[0])
    node = socket.socket(fileno=int(arguments[1]))
    driver = UrDriver(settings, node)
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, lambda *_: driver.end("the driver was asked to end"))
    try:
        with driver_process.alone(settings.address):
            driver_process.die_with_parent()
            driver_process.realtime(settings.realtime, settings.address)
            gc.freeze()
            gc.disable()  # the loop makes no cycles, and a collection would be late
            driver.run()
    except (driver_process.NotHere, RtdeRefused, TimeoutError) as error:
        print(f"{settings.address}: {error}", file=sys.stderr, flush=True)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
