"""Primary and secondary interface of an emulated UR controller: scripts in, states out, no sockets.

A client sends URScript as text: a program from `def` to its `end`, or single lines. It receives
states at 10 Hz. The primary interface (port 30001) adds messages; both begin with the version.
"""

from __future__ import annotations

import re
import struct
import zlib
from itertools import islice

from surg_emulators.ur.robot_states import EMERGENCY, Runtime, SafetyMode, joint_mode
from surg_emulators.ur.ur_controller import UrController

ROBOT_STATE, ROBOT_MESSAGE = 16, 20
VERSION_MESSAGE, TEXT_MESSAGE = 3, 0
MODE_DATA, JOINT_DATA, CARTESIAN_DATA, KINEMATICS_DATA = 0, 1, 4, 5
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
        self._said = self._controller.said
        return self._message(VERSION_MESSAGE, body) + self.state()

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
            CARTESIAN_DATA: struct.pack(">12d", *c.tcp_pose(c.motion.actual_q), *c.tcp_offset),
            KINEMATICS_DATA: self._kinematics(),
        }
        body = b"".join(struct.pack(">IB", len(p) + 5, kind) + p for kind, p in parts.items())
        return struct.pack(">IB", len(body) + 5, ROBOT_STATE) + body

    def _run(self, script: str) -> None:
        if not self._controller.remote:
            self._controller.say("a script was ignored: the robot is in local control")
        elif script.lstrip().startswith("sec"):
            self._controller.run_secondary(script)
        elif script.strip() == "stop program":
            self._controller.stop()
        elif script.strip() == "pause program":
            self._controller.pause()
        else:
            self._controller.run_script(script)

    def _message(self, kind: int, body: bytes) -> bytes:
        time = round(self._controller.timestamp * 1e6)
        head = struct.pack(">Qbb", max(time, 0), -2, kind)
        return struct.pack(">IB", len(head) + len(body) + 5, ROBOT_MESSAGE) + head + body

    def _new_messages(self) -> bytes:
        c = self._controller
        new = min(c.said - self._said, len(c.messages))
        self._said = c.said
        if self._service != "primary" or not new:
            return b""
        texts = islice(c.messages, len(c.messages) - new, None)
        return b"".join(self._message(TEXT_MESSAGE, text.encode()) for text in texts)

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
        calibrated = any(any(row) for row in c.dh_errors)
        return struct.pack(">6I24dI", *checks, *[0.0] * 6, *a, *d, *alpha, calibrated)
