"""The keyboard of a terminal: held keys move the tip. It needs a process of its own.

A terminal repeats a held key and does not report its release. So a key counts for HOLD after each
repeat: a tap is a small step, and a held key moves on once the repeat sets in.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import select
import sys
import termios
import tty
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from surg_core.hand.leader_sample import HandRate, LeaderSample
from surg_teleop.leaders.leader import LeaderError

HOLD = 0.15
"""[s] A key counts this long after its last repeat. Consoles repeat every 92 ms, others faster."""
IDLE = 10.0
"""[s] After this time without any key the keyboard is silent: nobody may be there."""
PULSE = 0.2
"""[s] A key that stands for a button counts as pressed for this time."""
MAX_STEP = 0.05
"""[s] Longest time over which the grip is integrated."""
SPEEDS = (0.002, 0.005, 0.01, 0.02, 0.04)
"""[m/s] Of the tip before scaling; ``+`` and ``-`` choose."""
ROLL_SPEED, GRIP_SPEED = 1.0, 1.0
"""[rad/s]; [1/s], so the jaw opens in 1 s."""

MOVES = {
    "left": (-1.0, 0.0, 0.0),
    "right": (1.0, 0.0, 0.0),
    "up": (0.0, -1.0, 0.0),
    "down": (0.0, 1.0, 0.0),
    "away": (0.0, 0.0, 1.0),
    "nearer": (0.0, 0.0, -1.0),
}
"""Directions in V."""
ROLLS = {"roll clockwise": 1.0, "roll back": -1.0}
GRIPS = {"open": 1.0, "close": -1.0}
PULSES = {"enable", "record"}

KEYS = {
    "a": "left",
    "d": "right",
    "w": "up",
    "s": "down",
    "e": "away",
    "q": "nearer",
    "l": "roll clockwise",
    "j": "roll back",
    "o": "open",
    "p": "close",
    " ": "clutch",
    "\r": "enable",
    "\n": "enable",
    "R": "record",
    "+": "faster",
    "-": "slower",
}
for _letter, _act in {"D": "left", "C": "right", "A": "up", "B": "down"}.items():
    KEYS[f"\x1b[{_letter}"] = KEYS[f"\x1bO{_letter}"] = _act  # both modes of a terminal's arrows
HELP = """\
  arrows or w a s d   up, left, down, right in the picture
  e q                 away from you, nearer
  l j                 roll clockwise, back
  o p                 jaw: open, pinch
  + -                 faster, slower
  space               clutch on, off
  return              enable: the arm follows
  R                   recording on, off
  Ctrl-C              end
"""


@dataclass
class Typing:
    """What the keys mean. Pure: text and time in, samples out."""

    clutch: bool = False
    speed: int = 2  # index into SPEEDS
    grip: float | None = None  # opening of the jaw; None before its first key
    _heard: dict[str, float] = field(default_factory=dict, repr=False)
    _last: float | None = field(default=None, repr=False)
    _rest: str = field(default="", repr=False)
    _now: float | None = field(default=None, repr=False)

    def type(self, text: str, now: float) -> None:
        """Take what was typed: characters and escape sequences, which may come in pieces."""
        text = self._rest + text
        self._rest = ""
        while text:
            key = next((k for k in sorted(KEYS, key=len, reverse=True) if text.startswith(k)), "")
            if key:
                self._press(KEYS[key], now)
            elif any(k.startswith(text) for k in KEYS):
                self._rest = text  # the beginning of a sequence
                return
            text = text[len(key) or 1 :]

    def sample(self, now: float) -> LeaderSample | None:
        """The sample of the keys; None: nobody has typed for IDLE."""
        step = min(max(now - (self._now if self._now is not None else now), 0.0), MAX_STEP)
        self._now = now
        if self._last is None or now - self._last > IDLE:
            return None
        held = {act for act, heard in self._heard.items() if now - heard <= HOLD}
        v_V = SPEEDS[self.speed] * sum(
            (np.array(MOVES[act]) for act in sorted(held & MOVES.keys())), np.zeros(3)
        )
        pull = sum(GRIPS[act] for act in held & GRIPS.keys())
        if pull:
            # The first key starts from closed: no jaw opens by itself.
            self.grip = min(1.0, max(0.0, (self.grip or 0.0) + GRIP_SPEED * pull * step))
        roll = ROLL_SPEED * sum(ROLLS[act] for act in held & ROLLS.keys())
        buttons = {act for act in PULSES if now - self._heard.get(act, -np.inf) <= PULSE}
        buttons |= {"present"} | ({"clutch"} if self.clutch else set())
        return LeaderSample(
            stamp=now, rate=HandRate(v_V, roll), grip=self.grip, buttons=frozenset(buttons)
        )

    def _press(self, act: str, now: float) -> None:
        self._last = self._heard[act] = now
        if act == "clutch":
            self.clutch = not self.clutch
        elif act in ("faster", "slower"):
            step = 1 if act == "faster" else -1
            self.speed = min(max(self.speed + step, 0), len(SPEEDS) - 1)


class Keyboard:
    """Reads a terminal; without a descriptor, the one in which this process was started."""

    mapping = "rate"

    def __init__(self, name: str = "keyboard", fd: int | None = None) -> None:
        self.name = name
        self._fd = fd
        self._saved: list[Any] | None = None
        self._typing = Typing()

    def open(self) -> None:
        """Let the terminal pass every key at once, without echo, until :meth:`close`.

        Raises:
            LeaderError: Standard input is no terminal, or another process has it.
        """
        if self._saved is not None:
            return
        fd = sys.stdin.fileno() if self._fd is None else self._fd
        if not os.isatty(fd):
            raise LeaderError(
                "standard input is no terminal", self.name, "start it in a terminal, by itself"
            )
        if os.tcgetpgrp(fd) != os.getpgrp():
            raise LeaderError(
                "runs in the background", self.name, "start it without '&', or bring it to front"
            )
        self._fd, self._saved = fd, termios.tcgetattr(fd)
        atexit.register(self.close)
        tty.setcbreak(fd)
        self._typing = Typing()

    def read(self, now: float) -> LeaderSample | None:
        """The sample of the keys.

        Raises:
            LeaderError: The terminal has gone.
        """
        if self._saved is None or self._fd is None:
            return None
        self._typing.type(self._typed(self._fd).decode("ascii", "replace"), now)
        return self._typing.sample(now)

    def close(self) -> None:
        """Restore the terminal."""
        saved, self._saved = self._saved, None
        if saved is None or self._fd is None:
            return
        atexit.unregister(self.close)
        with contextlib.suppress(OSError, termios.error):  # the terminal itself may have gone
            termios.tcsetattr(self._fd, termios.TCSADRAIN, saved)

    def _typed(self, fd: int) -> bytes:
        """What was typed since the last call; never waits."""
        try:
            if not select.select([fd], [], [], 0.0)[0]:
                return b""
            data = os.read(fd, 1024)
        except OSError:
            data = b""
        if not data:
            self.close()
            raise LeaderError("the terminal has gone", self.name, "start it in another")
        return data
