"""A recording of a free tool at rest: CSV with joint positions and mean readings of the sensor.

::

    serial,shoulder_pan_joint,...,fx,fy,fz,tx,ty,tz,n
    A1,0.1012,...,1.93,-1.52,0.17,0.081,-0.049,0.030,250

Angles in rad, forces in N, moments in N m as the sensor gives them, ``n`` readings in each mean.
``serial`` of the arm may be left out. ``text_table`` says which forms of CSV are read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from surg_core._core import CalibrationError, Chain
from surg_core.config import PathLike
from surg_core.force.load_solver import Posture
from surg_core.reading.text_table import read_table
from surg_core.replace_file import exact_number
from surg_core.transforms import FloatArray

READING = ("fx", "fy", "fz", "tx", "ty", "tz")


@dataclass(frozen=True, eq=False)
class ForceRecording:
    """Postures of a free tool.

    Attributes:
        postures: In the file's order.
        serial: Of the arm; empty: not stated.
    """

    postures: tuple[Posture, ...]
    serial: str = ""


def header(joint_names: Sequence[str], serial: str = "") -> str:
    """First line of a recording."""
    return ",".join([*(["serial"] if serial else []), *joint_names, *READING, "n"])


def row(q: FloatArray, reading: FloatArray, n: int, serial: str = "") -> str:
    """A line: joint positions [rad], mean reading (6,) as the sensor gives it, readings in it."""
    numbers = [f"{value:.9f}" for value in q] + [exact_number(float(v)) for v in reading]
    return ",".join([*([serial] if serial else []), *numbers, str(n)])


def read_forces(
    path: PathLike, chain: Chain, joint_names: Sequence[str], g_B: FloatArray, sign: float
) -> ForceRecording:
    """Read a recording.

    Args:
        path: The CSV file.
        chain: The robot, from base to flange.
        joint_names: In the chain's order; columns may come in any order.
        g_B: (3,) gravity in the base [m/s^2].
        sign: Of the sensor's file.

    Raises:
        CalibrationError: With file, line and what is wrong.
    """
    names, rows = read_table(path, CalibrationError)
    expected = sorted([*joint_names, *READING, "n"])
    if sorted(name for name in names if name != "serial") != expected:
        raise CalibrationError(
            f"{path}: the header is {','.join(names)}; needed is "
            f"{header(joint_names)}, and serial where known"
        )
    postures, serials = [], set()
    for row in rows:
        serials.add(row.words.get("serial", ""))
        found = {name: row.number(name) for name in expected}
        if not 1 <= found["n"] <= 1_000_000:
            raise CalibrationError(f"{row.where}: n is {found['n']:g}; allowed: 1 to 1000000")
        R_BF = chain.forward(np.array([found[name] for name in joint_names]))[:3, :3]
        reading = sign * np.array([found[name] for name in READING])
        postures.append(Posture(R_BF.T @ g_B, reading, int(found["n"])))
    if len(serials) > 1:
        arms = ", ".join(sorted(serials))
        raise CalibrationError(f"{path}: serial: {arms}; a recording is of one arm")
    return ForceRecording(tuple(postures), serials.pop() if serials else "")
