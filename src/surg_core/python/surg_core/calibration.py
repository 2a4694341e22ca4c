"""From a recording to a calibration file: reads the CSV, solves by the core, writes the YAML.

A recording is a CSV file of poses at standstill. Its first column says what the instrument was
doing, the others where the arm was, either as joint positions under the robot's joint names [rad]
or as flange poses in the robot base [m, unit quaternion]::

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
from pathlib import Path
from typing import Callable, TypeVar

import numpy as np

from surg_core._core import (
    AxisFit,
    CalibrationError,
    Chain,
    PointFit,
    TipFit,
    ToolCalibration,
    TrocarCalibration,
    calibrate_axis_by_points,
    calibrate_axis_by_rolling,
    calibrate_tip,
    calibrate_trocar,
    load_kinematics,
    load_tool,
    load_trocar,
    tool_calibration,
    trocar_calibration,
)
from surg_core.config import PathLike
from surg_core.reading.text_table import read_table
from surg_core.replace_file import fixed_decimals, one_line, replace_file, yaml_text
from surg_core.transforms import FloatArray, quaternion_xyzw_to_matrix

MOTIONS = ("tip", "roll", "second", "trocar", "touch")
SERIAL = "serial"
POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")

_Calibration = TypeVar("_Calibration", ToolCalibration, TrocarCalibration)


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


@dataclass(frozen=True)
class ToolSolution:
    """A calibrated tool with its parts."""

    tool: ToolCalibration
    tip: TipFit
    axis: AxisFit


@dataclass(frozen=True)
class TrocarSolution:
    """A calibrated trocar point with its fit."""

    trocar: TrocarCalibration
    point: PointFit


def read_recording(path: PathLike, chain: Chain, joint_names: Sequence[str]) -> Recording:
    """Reads a recording (see the module's text for the format).

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


def solve_tool(recording: Recording, date: str) -> ToolSolution:
    """Tip and shaft axis from the motions ``tip`` and ``roll``, or ``tip`` and ``second``.

    Args:
        recording: the poses.
        date: goes into the file, such as ``2026-11-21``.

    Raises:
        CalibrationError: for a missing motion, or as the solvers.
    """
    if "roll" in recording.poses and "second" in recording.poses:
        raise CalibrationError(
            f"{recording.file}: holds both 'roll' and 'second'; one of them gives the shaft axis"
        )
    tip = _named(recording, lambda: calibrate_tip(recording.of("tip", "the tool's tip")))
    if "second" in recording.poses:
        axis = _named(
            recording,
            lambda: calibrate_axis_by_points(tip, calibrate_tip(recording.poses["second"])),
        )
    else:
        roll = recording.of("roll", "the shaft axis ('second' would do as well)")
        axis = _named(recording, lambda: calibrate_axis_by_rolling(roll, tip.p_FTip))
    return ToolSolution(tool_calibration(tip, axis, date), tip, axis)


def solve_trocar(
    recording: Recording,
    tool: ToolCalibration,
    date: str,
) -> TrocarSolution:
    """The trocar point from the motion ``trocar``.

    Args:
        recording: the poses.
        tool: the calibrated tool whose shaft ran through the trocar.
        date: goes into the file.

    Raises:
        CalibrationError: for a missing motion, or as the solver.
    """
    X_BF = recording.of("trocar", "the trocar point")
    p_B = X_BF[:, :3, :3] @ tool.p_FTip + X_BF[:, :3, 3]
    s_B = X_BF[:, :3, :3] @ tool.s_F
    point = _named(recording, lambda: calibrate_trocar(p_B, s_B))
    return TrocarSolution(trocar_calibration(point, date), point)


def touched_points(recording: Recording, tool: ToolCalibration) -> FloatArray:
    """The points ``(n, 3)`` that the tip has touched, in the robot base [m].

    Raises:
        CalibrationError: The recording has no motion ``touch``.
    """
    X_BF = recording.of("touch", "the bases")
    points: FloatArray = X_BF[:, :3, :3] @ tool.p_FTip + X_BF[:, :3, 3]
    return points


_Fit = TypeVar("_Fit")


def _named(recording: Recording, solve: Callable[[], _Fit]) -> _Fit:
    """Puts the file's name before a refusal."""
    try:
        return solve()
    except CalibrationError as error:
        raise CalibrationError(f"{recording.file}: {error}") from error


def write_tool(
    path: PathLike, tool: ToolCalibration, note: str, source: str = "measured", serial: str = ""
) -> None:
    """Writes a surg_tool/1 file; the file that was there stays beside it as ``<name>.previous``.

    Args:
        path: such as ``calibration/tool_PSM1.yaml``; its folder must exist.
        tool: what to write.
        note: one line for people, put at the top.
        source: ``measured``, ``simulated`` or ``computed``.
        serial: of the arm that was measured; empty: it has none.

    Raises:
        ConfigError: when the schema does not take it (nothing is replaced then).
        OSError: when it cannot be written.
    """
    text = (
        f"# {one_line(note)}\n"
        "format: surg_tool/1\n"
        f"shaft_axis: {fixed_decimals(tool.s_F)}  # unit vector, flange to tip\n"
        f"tip: {fixed_decimals(tool.p_FTip)}  # m\n" + _evidence(tool, source, serial)
    )
    replace_file(Path(path), text, load_tool)


def write_trocar(
    path: PathLike,
    trocar: TrocarCalibration,
    note: str,
    source: str = "measured",
    serial: str = "",
) -> None:
    """Writes a surg_trocar/1 file; as :func:`write_tool`."""
    text = (
        f"# {one_line(note)}\n"
        "format: surg_trocar/1\n"
        f"point: {fixed_decimals(trocar.p_BRcm)}  # m\n" + _evidence(trocar, source, serial)
    )
    replace_file(Path(path), text, load_trocar)


def kinematics_text(
    model: str, serial: str, date: str, parameters: Mapping[str, Sequence[float]]
) -> str:
    """A surg_kinematics/1 file: an arm's own kinematics, as its controller states them.

    Args:
        model: the robot's name, such as ``ur5e``.
        serial: of the arm.
        date: of the reading, such as ``2026-11-23``.
        parameters: ``theta``, ``a``, ``d``, ``alpha``: standard Denavit-Hartenberg parameters, one
            value per joint [rad, m]; ``theta`` is added to the joint position.
    """
    rows = "".join(
        f"{name}: [{', '.join(repr(float(value)) for value in parameters[name])}]  # {unit}\n"
        for name, unit in (("theta", "rad"), ("a", "m"), ("d", "m"), ("alpha", "rad"))
    )
    return (
        "# This arm's own Denavit-Hartenberg parameters: ./surg robot CELL kinematics\n"
        "format: surg_kinematics/1\n"
        f"model: {yaml_text(model)}\n"
        f"serial: {yaml_text(serial)}\n"
        f'date: "{one_line(date)}"\n' + rows
    )


def write_kinematics(path: PathLike, text: str) -> None:
    """Writes a surg_kinematics/1 file; as :func:`write_tool`."""
    replace_file(Path(path), text, load_kinematics)


def _evidence(found: _Calibration, source: str, serial: str) -> str:
    of_arm = f"serial: {yaml_text(serial)}  # of the arm\n" if serial else ""
    return (
        f"residual: {found.residual:.9f}  # m, rms\n"
        f"n: {found.n}\n"
        f"condition: {max(found.condition, 1.0):.4f}\n"
        f'date: "{one_line(found.date)}"\n'
        f"source: {source}\n" + of_arm
    )
