"""The Lambda.7's force feedback (`src/surg_lambda7/src/haptics.cpp`), called from Python."""

from __future__ import annotations

import ctypes
import subprocess
from pathlib import Path

import numpy as np

from surg_cli.host import paths

CODE = paths.ROOT / "src" / "surg_lambda7" / "src"
NUMBER = ctypes.c_double
VECTOR = np.ctypeslib.ndpointer(np.float64, shape=(3,), flags="C_CONTIGUOUS")


class Haptics:
    """The compiled feedback.

    Args:
        folder: Where the library is built.
    """

    def __init__(self, folder: Path) -> None:
        made = folder / "haptics.so"
        sources = [str(Path(__file__).with_suffix(".cpp")), str(CODE / "haptics.cpp")]
        flags = ["-std=c++17", "-O1", "-shared", "-fPIC", f"-I{CODE}"]
        command = ["c++", *flags, "-isystem/usr/include/eigen3", *sources, "-o", str(made)]
        subprocess.run(command, check=True)
        self.code = ctypes.CDLL(str(made))
        for name in ("channel_new", "feedback_new"):
            getattr(self.code, name).restype = ctypes.c_void_p
        for name in ("channel_step", "channel_energy", "feedback_energy", "feedback_gate"):
            getattr(self.code, name).restype = NUMBER

    def channel(self, damping: float, force: float) -> Channel:
        """One axis with its largest damping [N s/m] and force [N]."""
        return Channel(self.code, self.code.channel_new(NUMBER(damping), NUMBER(force)))

    def feedback(self, max_force: float = 5.0, max_rate: float = 200.0) -> Feedback:
        """All three axes with their limits [N], [N/s]."""
        scale = NUMBER(1.0)
        made = self.code.feedback_new(scale, NUMBER(max_force), NUMBER(max_rate))
        return Feedback(self.code, made)


class Channel:
    """``PassivityChannel``."""

    def __init__(self, code: ctypes.CDLL, made: int) -> None:
        self._code, self._made = code, ctypes.c_void_p(made)

    def step(self, wanted: float, position: float, dt: float) -> float:
        """The force until the next step [N]."""
        numbers = (NUMBER(wanted), NUMBER(position), NUMBER(dt))
        return float(self._code.channel_step(self._made, *numbers))

    @property
    def energy(self) -> float:
        """That the hand has put in [J]."""
        return float(self._code.channel_energy(self._made))


class Feedback:
    """``HapticFeedback``."""

    def __init__(self, code: ctypes.CDLL, made: int) -> None:
        self._code, self._made = code, ctypes.c_void_p(made)
        flag = ctypes.c_bool
        code.feedback_step.argtypes = (
            *(ctypes.c_void_p, VECTOR, NUMBER, VECTOR, flag, NUMBER, VECTOR),
        )

    def step(
        self, force: np.ndarray, age: float, position: np.ndarray, allowed: bool, dt: float
    ) -> np.ndarray:
        """The force (3,) on the hand until the next step [N]."""
        out = np.empty(3)
        self._code.feedback_step(self._made, force, age, position, allowed, dt, out)
        return out

    @property
    def energy(self) -> float:
        """That the hand has put into the first axis [J]."""
        return float(self._code.feedback_energy(self._made, 0))

    @property
    def gate(self) -> float:
        """Share of the force that is let through, 0 to 1."""
        return float(self._code.feedback_gate(self._made))
