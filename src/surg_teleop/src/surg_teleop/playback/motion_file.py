"""A recorded hand motion: read from CSV, checked, and interpolated.

File format: a text table (``reading.text_table``). Required columns: ``t_s`` [s], ``x_m``, ``y_m``,
``z_m`` [m]. Optional: ``roll_rad`` [rad] or the nine columns ``r11`` ... ``r33`` of a rotation
matrix (row by row), and ``gripper_rad`` [rad]. Other columns are ignored and reported.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from surg_core.arm_view import Array
from surg_core.reading.text_table import read_table
from surg_core.transforms import twist_angle

REQUIRED = ("t_s", "x_m", "y_m", "z_m")
ROTATION = tuple(f"r{row}{column}" for row in "123" for column in "123")
KNOWN = (*REQUIRED, "roll_rad", *ROTATION, "gripper_rad")

MIN_SAMPLES = 4
"""Needed by a cubic spline."""
MIN_DURATION = 0.5
"""[s] Shortest motion."""
MAX_GAP = 0.5
"""[s] Longest gap between samples; a spline across a longer one would be a guess."""
JUMP_SPEED = 1.0
"""[m/s] Between samples; four times the fastest tip of 37 recorded knot-tying trials (0.25 m/s).
Faster motions are glitches of a tracker or concatenated files."""
JUMP_SLACK = 0.002
"""[m] Allowance for noise of the samples."""
ROLL_JUMP_SPEED = 20.0
"""[rad/s] Between samples; a surgeon's wrist rolls at up to 5.7 rad/s."""
ROLL_JUMP_SLACK = 0.1
"""[rad] Allowance for noise of the roll."""
ROTATION_TOLERANCE = 1e-2
"""Largest entry of R R^T - I, for rotations printed with few digits."""
MIN_TWIST = 1e-3
"""|cos(swing / 2)| must exceed this: swing–twist has no answer where the handle points back."""
HAND_SPACE = 2.0
"""[m] No hand moves so far; numbers that do are in another unit."""
LIKE_MILLIMETRES = "; this looks like millimetres: divide x, y and z by 1000"
LIKE_MILLISECONDS = "; this looks like milliseconds: divide t_s by 1000"


class MotionError(ValueError):
    """A motion that must not be played: says which file, where, which value and what is allowed."""


@dataclass(frozen=True)
class Motion:
    """A motion checked by :func:`read_motion`.

    Attributes:
        file: Its file, for messages.
        t: (n,) time since the first sample [s], strictly increasing from 0.
        p: (n, 3) position as recorded [m].
        roll: (n,) roll about the handle axis since the first sample [rad], unwrapped; zeros if
            the file has none.
        gripper: (n,) gripper opening [rad] or None.
        lines: (n,) line of each sample in the file, for messages.
        ignored: Unused columns of the file.
        turns: (n, 3, 3) rotation from the mean of all samples, in the axes of ``p``; None: the file
            has none. Only a wristed instrument follows it.
    """

    file: str
    t: Array
    p: Array
    roll: Array
    gripper: Array | None
    lines: NDArray[np.int64]
    ignored: tuple[str, ...] = ()
    turns: Array | None = None

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.t[-1])

    @property
    def box(self) -> tuple[Array, Array]:
        """Lowest and highest position per axis, each (3,) [m]."""
        return self.p.min(axis=0), self.p.max(axis=0)

    def cut(self, duration: float) -> Motion:
        """The motion up to the last sample within a duration [s], at least MIN_DURATION."""
        if duration >= self.duration:
            return self
        n = max(int(np.searchsorted(self.t, duration, side="right")), MIN_SAMPLES)
        gripper = None if self.gripper is None else self.gripper[:n]
        return replace(
            self,
            t=self.t[:n],
            p=self.p[:n],
            roll=self.roll[:n],
            gripper=gripper,
            lines=self.lines[:n],
            turns=None if self.turns is None else self.turns[:n],
        )

    def spline(self) -> CubicSpline:
        """Interpolant with continuous acceleration over (x, y, z [m], roll [rad]).

        It passes through all samples, with zero acceleration at both ends.
        """
        return CubicSpline(self.t, np.column_stack((self.p, self.roll)), bc_type="natural")

    def gripper_at(self, t: float) -> float | None:
        """Gripper opening [rad] at a time [s], linear between samples, held beyond the ends."""
        return None if self.gripper is None else float(np.interp(t, self.t, self.gripper))


def read_motion(path: Path) -> Motion:
    """Read and check a motion file.

    Raises:
        MotionError: The file cannot be read, or an arm must not follow it.
    """
    header, rows, lines = _read_table(path)
    column = {name: index for index, name in enumerate(header)}
    t, p = rows[:, column["t_s"]], rows[:, [column[name] for name in REQUIRED[1:]]]
    _check_time(path, t, lines)
    _check_jumps(path, t, p, lines)
    turns = None
    if "roll_rad" in column:
        roll = np.unwrap(rows[:, column["roll_rad"]])
    elif "r11" in column:
        rotations = rows[:, [column[name] for name in ROTATION]].reshape(-1, 3, 3)
        roll = _handle_roll(path, rotations, lines)
        turned = Rotation.from_matrix(rotations)
        turns = (turned * turned.mean().inv()).as_matrix()
    else:
        roll = np.zeros(len(t))
    _check_roll_jumps(path, t, roll, lines)
    return Motion(
        file=str(path),
        t=t - t[0],
        p=p,
        roll=roll - roll[0],
        gripper=rows[:, column["gripper_rad"]] if "gripper_rad" in column else None,
        lines=np.array(lines, dtype=np.int64),
        ignored=tuple(name for name in header if name not in KNOWN),
        turns=turns,
    )


def _read_table(path: Path) -> tuple[tuple[str, ...], Array, list[int]]:
    """The header, the numbers (n, columns), and the line of each row in the file."""
    header, rows = read_table(path, MotionError)
    _check_header(path, header)
    values = [[row.number(name) if name in KNOWN else 0.0 for name in header] for row in rows]
    if len(rows) < MIN_SAMPLES:
        raise MotionError(
            f"{path}: {len(rows)} samples; allowed: at least {MIN_SAMPLES}, over {MIN_DURATION} s"
        )
    return header, np.array(values), [row.line for row in rows]


def _check_header(path: Path, header: tuple[str, ...]) -> None:
    missing = [name for name in REQUIRED if name not in header]
    if missing:
        raise MotionError(
            f"{path}: line 1: column {', '.join(missing)} missing; the header is "
            f"'{','.join(header)}'; allowed: {','.join(REQUIRED)} and optionally roll_rad or "
            "r11 to r33, and gripper_rad"
        )
    rotation = [name for name in ROTATION if name in header]
    if rotation and len(rotation) < len(ROTATION):
        absent = [name for name in ROTATION if name not in header]
        raise MotionError(
            f"{path}: line 1: column {', '.join(absent)} missing; allowed: all of r11 to r33, "
            "or none of them"
        )
    if rotation and "roll_rad" in header:
        raise MotionError(f"{path}: line 1: both roll_rad and r11 to r33; allowed: one of the two")


def _check_time(path: Path, t: Array, lines: list[int]) -> None:
    steps = np.diff(t)
    backwards = np.flatnonzero(~(steps > 0))
    if backwards.size:
        i = int(backwards[0]) + 1
        raise MotionError(
            f"{path}: line {lines[i]}: t_s is {t[i]:.6f} after {t[i - 1]:.6f}; allowed: increasing "
            "times"
        )
    gaps = np.flatnonzero(steps > MAX_GAP)
    if gaps.size:
        i = int(gaps[0]) + 1
        raise MotionError(
            f"{path}: line {lines[i]}: t_s is {t[i]:.6f}, {steps[i - 1]:.3f} s after the sample "
            f"before; allowed: {MAX_GAP} s"
            + (LIKE_MILLISECONDS if float(np.median(steps)) > 1.0 else "")
        )
    if t[-1] - t[0] < MIN_DURATION:
        raise MotionError(
            f"{path}: the motion lasts {t[-1] - t[0]:.3f} s; allowed: at least {MIN_DURATION} s"
        )


def _check_jumps(path: Path, t: Array, p: Array, lines: list[int]) -> None:
    step = np.linalg.norm(np.diff(p, axis=0), axis=1)
    allowed = JUMP_SPEED * np.diff(t) + JUMP_SLACK
    jumps = np.flatnonzero(~(step <= allowed))
    if jumps.size:
        i = int(jumps[0])
        raise MotionError(
            f"{path}: line {lines[i + 1]}: the position jumps by {1e3 * step[i]:.1f} mm in "
            f"{t[i + 1] - t[i]:.4f} s; allowed: {1e3 * allowed[i]:.1f} mm "
            f"({JUMP_SPEED} m/s and {1e3 * JUMP_SLACK:.0f} mm)"
            + (LIKE_MILLIMETRES if float(np.ptp(p, axis=0).max()) > HAND_SPACE else "")
        )


def _check_roll_jumps(path: Path, t: Array, roll: Array, lines: list[int]) -> None:
    step = np.abs(np.diff(roll))
    allowed = ROLL_JUMP_SPEED * np.diff(t) + ROLL_JUMP_SLACK
    jumps = np.flatnonzero(~(step <= allowed))
    if jumps.size:
        i = int(jumps[0])
        raise MotionError(
            f"{path}: line {lines[i + 1]}: the roll jumps by {step[i]:.3f} rad in "
            f"{t[i + 1] - t[i]:.4f} s; allowed: {allowed[i]:.3f} rad "
            f"({ROLL_JUMP_SPEED:.0f} rad/s and {ROLL_JUMP_SLACK} rad)"
        )


def _handle_roll(path: Path, rotations: Array, lines: list[int]) -> Array:
    defect = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    bad = np.flatnonzero(~((defect <= ROTATION_TOLERANCE) & (np.linalg.det(rotations) > 0)))
    if bad.size:
        i = int(bad[0])
        raise MotionError(
            f"{path}: line {lines[i]}: r11 to r33 are not a rotation (R R^T differs from 1 by "
            f"{defect[i]:.3g}, determinant {np.linalg.det(rotations[i]):.3g}); allowed: "
            f"{ROTATION_TOLERANCE} and a positive determinant"
        )
    relative = np.einsum("ji,njk->nik", rotations[0], rotations)
    twist, quality = twist_angle(relative)
    lost = np.flatnonzero(quality < MIN_TWIST)
    if lost.size:
        raise MotionError(
            f"{path}: line {lines[int(lost[0])]}: the handle points against its direction in the "
            "first sample, so its roll is undefined; allowed: any smaller turn"
        )
    return np.unwrap(twist)
