"""Recordings of an arm's poses at standstill: CSV files, for a calibration.

The first column says what the instrument was doing, the others where the arm was, either as joint
positions under the robot's joint names [rad] or as flange poses in the robot base [m, unit
quaternion]::

    motion,shoulder_pan_joint,shoulder_lift_joint,elbow_joint,wrist_1_joint,...
    tip,0.1012,-1.2037,...

    motion,x,y,z,qx,qy,qz,qw
    tip,0.4210,0.1033,0.2101,0.0,1.0,0.0,0.0

``text_table`` says which forms of CSV are read. Motions are

======== ==========================================================================================
tip      the tip rests in a fixed divot; tilted about two axes and rolled between the poses
roll     the shaft lies in a snug guide; turned about itself between the poses, free to slide
second   as ``tip``, with a rod of another length in the same holder (instead of ``roll``)
trocar   the shaft runs through the trocar, differently tilted
touch    the tip touches points that another arm's tip touches too, in the same order
======== ==========================================================================================

A column ``serial`` may state the arm that was measured, the same in every row.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from surg_core._core import CalibrationError, Chain
from surg_core.config import PathLike
from surg_core.reading.text_table import read_table
from surg_core.transforms import FloatArray, quaternion_xyzw_to_matrix

MOTIONS = ("tip", "roll", "second", "trocar", "touch")
SERIAL = "serial"
POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")


@dataclass(frozen=True)
class Recording:
    """Flange poses by motion.

    Attributes:
        file: Where they come from; named in errors.
        poses: Motion -> ``(n, 4, 4)`` flange poses X_BF.
        serial: Of the arm that was measured; empty: not stated.
    """

    file: str
    poses: Mapping[str, FloatArray]
    serial: str = ""

    def of(self, motion: str, purpose: str) -> FloatArray:
        """The poses of one motion.

        Raises:
            CalibrationError: when there are none.
        """
        if motion not in self.poses:
            found = ", ".join(self.poses) or "none"
            raise CalibrationError(
                f"{self.file}: no row of motion '{motion}', needed for {purpose}; found: {found}"
            )
        return self.poses[motion]


def read_recording(path: PathLike, chain: Chain, joint_names: Sequence[str]) -> Recording:
    """Reads a recording in the format of this module's text.

    Args:
        path: the CSV file.
        chain: the robot, which turns joint positions into flange poses.
        joint_names: its joints in the chain's order; columns may come in any order.

    Raises:
        CalibrationError: with file, line and what is wrong.
    """
    header, rows = read_table(path, CalibrationError)
    joints = tuple(joint_names)
    stated = sorted(name for name in header if name != SERIAL)
    if stated not in (sorted(("motion", *joints)), sorted(("motion", *POSE))):
        raise CalibrationError(
            f"{path}: the header is {','.join(header)}; needed is "
            f"motion,{','.join(joints)} or motion,{','.join(POSE)}, and serial where known"
        )
    columns = joints if stated == sorted(("motion", *joints)) else POSE
    found: dict[str, list[FloatArray]] = {}
    serials: set[str] = set()
    for row in rows:
        motion = row.words["motion"]
        if motion not in MOTIONS:
            raise CalibrationError(
                f"{row.where}: motion '{motion}' is unknown; allowed are {', '.join(MOTIONS)}"
            )
        serials.add(row.words.get(SERIAL, ""))
        if len(serials) > 1:
            raise CalibrationError(
                f"{row.where}: serial {row.words[SERIAL]!r}, and other rows have another"
            )
        values = np.array([row.number(name) for name in columns])
        pose = _pose(values, row.where) if columns is POSE else chain.forward(values)
        found.setdefault(motion, []).append(pose)
    poses = {motion: np.array(each) for motion, each in found.items()}
    return Recording(str(path), poses, serials.pop() if serials else "")


def _pose(values: FloatArray, where: str) -> FloatArray:
    length = float(np.linalg.norm(values[3:]))
    if abs(length - 1.0) > 1e-3:
        raise CalibrationError(f"{where}: the quaternion has length {length:.4g}; 1 is needed")
    X_BF = np.eye(4)
    X_BF[:3, :3] = quaternion_xyzw_to_matrix(values[3:] / length)
    X_BF[:3, 3] = values[:3]
    return X_BF
