"""Emulated servos on a pseudo-terminal, in real time: what a drive's port is on a bench.

As a program: ``python3 -m surg_emulators.drive.drive_emulator PORT '{"servo_id": 1}' ...``, with
arguments of `Servo`. Lines on its standard input are faults, ``[at SECONDS] NAME [WORD ...]``;
``help`` lists them. It ends with that input.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import sys
import termios
import threading
import time
import tty
from collections.abc import Sequence
from pathlib import Path

from surg_emulators import emulator_program
from surg_emulators.drive.servo_line import ServoLine
from surg_emulators.drive.servo_motor import BAUDS, Servo

_SPEEDS = {getattr(termios, f"B{baud}"): baud for baud in BAUDS if hasattr(termios, f"B{baud}")}
"""Constant of the terminal -> [bit/s]."""
LOOK = 0.01
"""[s] At most, between two looks at an idle line."""


class DriveEmulator:
    """A line with servos behind a port; serves in a thread of its own until it is closed.

    Args:
        path: Where the port shall be: a link to the pseudo-terminal.
        servos: On the line.

    Raises:
        OSError: The link cannot be made.
    """

    def __init__(self, path: Path, servos: Sequence[Servo]) -> None:
        self.line = ServoLine(servos)
        self._path = path
        self._begun = time.monotonic()
        self._lock = threading.Lock()
        self._stopped = False
        self._ours = self._theirs = -1
        self.plug()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def plug(self) -> None:
        """Make the port."""
        ours, self._theirs = os.openpty()
        tty.setraw(self._theirs)
        os.set_blocking(ours, False)
        self._path.unlink(missing_ok=True)
        self._path.symlink_to(os.ttyname(self._theirs))
        self._ours = ours

    def unplug(self) -> None:
        """Take the port away, as if its cable were pulled; the servos keep their power."""
        with self._lock:
            ours, self._ours = self._ours, -1
            os.close(ours)
            os.close(self._theirs)
            self._path.unlink(missing_ok=True)

    def fault(self, line: str) -> str:
        """Let something go wrong; returns `ok`, or what is wrong with the line."""
        with self._lock:
            if line.strip() == "help":
                return self.line.schedule.help()
            return self.line.schedule.answer(line, self.line.now)

    def close(self) -> None:
        """End."""
        self._stopped = True
        self._thread.join()
        if self._ours >= 0:
            self.unplug()

    def _serve(self) -> None:
        coming: list[tuple[float, bytes]] = []
        while not self._stopped:
            next_answer = coming[0][0] - self._now() if coming else LOOK
            self._wait(min(max(next_answer, 0.0), LOOK))
            with self._lock, contextlib.suppress(BlockingIOError):
                self.line.step(self._now())
                if self._ours < 0:
                    continue
                coming += self._read()
                due = [data for at, data in coming if at <= self._now()]
                del coming[: len(due)]
                os.write(self._ours, b"".join(due))

    def _wait(self, seconds: float) -> None:
        """For bytes of the host; the port may be pulled meanwhile."""
        try:
            select.select((self._ours,), (), (), seconds)
        except (OSError, ValueError):
            time.sleep(seconds)

    def _read(self) -> list[tuple[float, bytes]]:
        try:
            data = os.read(self._ours, 4096)
        except OSError:
            return []
        baud = _SPEEDS.get(termios.tcgetattr(self._theirs)[5], 0)
        return self.line.receive(data, self._now(), baud) if baud else []

    def _now(self) -> float:
        return time.monotonic() - self._begun


def main(words: Sequence[str]) -> int:
    """Serve until the end of standard input; returns the exit code."""
    try:
        servos = [Servo(**json.loads(word)) for word in words[1:]]
        emulator_program.ask_real_time()  # the thread that serves inherits it
        emulator = DriveEmulator(Path(words[0]), servos)
    except (IndexError, TypeError, ValueError, OSError) as error:
        print(f"{error}\n{__doc__}", file=sys.stderr)
        return 2
    print(f"Emulated servos of an instrument: {words[0]}", flush=True)
    try:
        for line in sys.stdin:
            print(emulator.fault(line), flush=True)
    except KeyboardInterrupt:
        pass
    finally:
        emulator.close()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
