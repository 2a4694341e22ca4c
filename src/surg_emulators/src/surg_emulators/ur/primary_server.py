"""Primary and secondary interface of an emulated UR controller: scripts in, states out, no sockets.

A client sends URScript as text: a program from `def` to its `end`, or single lines. It receives
states at 10 Hz. The primary interface (port 30001) adds messages; both begin with the version.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable
from itertools import islice

from surg_emulators.ur import robot_messages
from surg_emulators.ur.dh_kinematics import TABLES
from surg_emulators.ur.joint_motion import MAX_ACCELERATION, MAX_POSITION, MAX_SPEED
from surg_emulators.ur.robot_messages import RobotMessage
from surg_emulators.ur.robot_states import EMERGENCY, Runtime, SafetyMode, joint_mode
from surg_emulators.ur.ur_controller import UrController

ROBOT_STATE, ROBOT_MESSAGE = 16, 20
MODE_DATA, JOINT_DATA, MASTERBOARD_DATA, CARTESIAN_DATA = 0, 1, 3, 4
KINEMATICS_DATA, CONFIGURATION_DATA = 5, 6
LINEARISED = 2
"""Calibration status of an arm that has left the works."""
ROBOT_TYPES = {"UR3e": 3, "UR5e": 1, "UR10e": 2}
CONTROL_BOX_E_SERIES, SUB_TYPE_E_SERIES = 2, 2
DIVIDER = 50
"""Cycles per state: 10 Hz."""
LONGEST_SCRIPT = 1 << 20
OPENS = re.compile(r"^\s*(def|thread|sec|while|if|switch)\b")
CLOSES = re.compile(r"^\s*end\b")


class ScriptBuffer:
    """Cuts a stream of text into programs."""

    def __init__(self) -> None:
        self.too_long = False
        self._rest = b""
        self._lines: list[str] = []
        self._depth = self._size = 0

    def feed(self, data: bytes) -> list[str]:
        """Take text; returns the programs that are complete."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        self.too_long = len(self._rest) + self._size > LONGEST_SCRIPT
        programs = []
        for each in lines:
            line = each.decode("utf-8", "replace")
            word = line.split("#")[0]
            self._depth += bool(OPENS.match(word)) - bool(CLOSES.match(word))
            self._depth = max(self._depth, 0)
            if word.strip() or self._depth:
                self._lines.append(line)
                self._size += len(line) + 1
            if self._depth == 0 and self._lines:
                programs.append("\n".join(self._lines))
                self._lines, self._size = [], 0
        return programs


class PrimarySession:
    """One connected client.

    Args:
        controller: The controller.
        service: `primary`; `secondary`, which sends no messages; `script`, which sends nothing.

    Attributes:
        closed: The connection must be closed.
    """

    def __init__(self, controller: UrController, service: str) -> None:
        self.closed = False
        self._controller, self._service = controller, service
        self._scripts = ScriptBuffer()
        self._said = 0

    def greeting(self) -> bytes:
        """What a client gets first: the version and the whole state."""
        if self._service == "script":
            return b""
        major, minor, bugfix, build = self._controller.version
        name, date = b"URControl", b"22-03-2022, 10:00:00"
        body = bytes([len(name)]) + name + struct.pack(">BBii", major, minor, bugfix, build) + date
        self._said = self._controller.announcements
        return self._message(RobotMessage(robot_messages.VERSION, body)) + self.state()

    def receive(self, data: bytes) -> bytes:
        """Take text of the client; runs the programs that are complete."""
        for script in self._scripts.feed(data):
            self._run(script)
        self.closed |= self._scripts.too_long
        return b""

    def output(self) -> bytes:
        """The state and new messages, where they are due in this cycle."""
        if self._controller.cycles % DIVIDER or self._service == "script":
            return b""
        return self.state() + self._new_messages()

    def state(self) -> bytes:
        """The robot state message."""
        c = self._controller
        parts = {
            MODE_DATA: self._mode(),
            JOINT_DATA: self._joints(),
            MASTERBOARD_DATA: self._masterboard(),
            CARTESIAN_DATA: struct.pack(">12d", *c.tcp_pose(c.motion.actual_q), *c.tcp_offset),
            KINEMATICS_DATA: self._kinematics(),
            CONFIGURATION_DATA: self._configuration(),
        }
        body = b"".join(struct.pack(">IB", len(p) + 5, kind) + p for kind, p in parts.items())
        return struct.pack(">IB", len(body) + 5, ROBOT_STATE) + body

    def _run(self, script: str) -> None:
        c = self._controller
        orders: dict[str, Callable[[], object]] = {
            "stop program": c.stop,
            "pause program": c.pause,
            "power on": c.power_on,
            "power off": c.power_off,
            "set robotmode run": c.release_brakes,
            "set unlock protective stop": lambda: c.unlock(at_once=True),  # as its tests say
        }
        if not c.remote:
            c.say("a script was ignored: the robot is in local control")
            c.announce(robot_messages.error_code(robot_messages.READ_ONLY, "read-only"))
        elif script.strip() in orders:
            orders[script.strip()]()
        elif script.lstrip().startswith("sec"):
            c.run_secondary(script)
        else:
            c.run_script(script)

    def _message(self, message: RobotMessage) -> bytes:
        time = round(self._controller.timestamp * 1e6)
        head = struct.pack(">Qbb", max(time, 0), -2, message.kind)
        size = 5 + len(head) + len(message.body)
        return struct.pack(">IB", size, ROBOT_MESSAGE) + head + message.body

    def _new_messages(self) -> bytes:
        c = self._controller
        new = min(c.announcements - self._said, len(c.announced))
        self._said = c.announcements
        if self._service != "primary" or not new:
            return b""
        messages = islice(c.announced, len(c.announced) - new, None)
        return b"".join(self._message(message) for message in messages)

    def _mode(self) -> bytes:
        c = self._controller
        flags = (
            True,
            True,
            c.powered,
            c.safety_mode in EMERGENCY,
            c.safety_mode == SafetyMode.PROTECTIVE_STOP,
            c.runtime == Runtime.PLAYING,
            c.runtime == Runtime.PAUSED,
        )
        return (
            struct.pack(">Q7?", max(round(c.timestamp * 1e6), 0), *flags)
            + struct.pack(">bB3d", c.shown_mode, 2 if c.guided else 0, c.slider, 1.0, 1.0)
            + b"\x00"
        )

    def _joints(self) -> bytes:
        c, motion = self._controller, self._controller.motion
        mode = joint_mode(c.shown_mode, c.safety_mode)
        return b"".join(
            struct.pack(
                ">3d4fB", c.shown_q[j], motion.q[j], motion.actual_qd[j], 0, 48, 28, 28, mode
            )
            for j in range(6)
        )

    def _kinematics(self) -> bytes:
        c = self._controller
        d, a, alpha = zip(*c.table, strict=True)
        checks = [zlib.crc32(struct.pack(">3d", *row)) for row in c.table]
        return struct.pack(">6I24dI", *checks, *[0.0] * 6, *a, *d, *alpha, LINEARISED)

    def _masterboard(self) -> bytes:
        c = self._controller
        inputs = struct.pack(">iibbddbbdd", 0, c.digital_outputs, 0, 0, 0, 0, 0, 0, 0, 0)
        power = struct.pack(">4f", 28.0, 48.0, 1.0, 0.0)
        modes = struct.pack(">B?BIBBB", c.safety_mode, c.reduced, 0, 0, 0, 0, 0)
        return inputs + power + modes

    def _configuration(self) -> bytes:
        """Limits, defaults and the nominal arm; clients learn the kind of arm from it."""
        c = self._controller
        d, a, alpha = zip(*TABLES[c.model], strict=True)
        limits = [-MAX_POSITION, MAX_POSITION] * 6 + [MAX_SPEED, MAX_ACCELERATION] * 6
        defaults = (1.05, 1.4, 0.25, 1.2, 0.05)  # joint speed and acceleration, tool's, radius
        kind = (1, CONTROL_BOX_E_SERIES, ROBOT_TYPES[c.model], SUB_TYPE_E_SERIES)
        return struct.pack(">53d4i", *limits, *defaults, *a, *d, *alpha, *[0.0] * 6, *kind)
