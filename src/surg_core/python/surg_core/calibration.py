"""From a recording to a calibration file: solves by the core, writes the YAML."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Callable, TypeVar

from surg_core._core import (
    AxisFit,
    CalibrationError,
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
from surg_core.reading.calibration_recording import Recording
from surg_core.replace_file import fixed_decimals, one_line, replace_file, yaml_text
from surg_core.transforms import FloatArray

_Calibration = TypeVar("_Calibration", ToolCalibration, TrocarCalibration)


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
