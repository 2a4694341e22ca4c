"""Writes a cell folder round one robot or several: the generator behind the bundled cells.

Each trocar point is put on the instrument's shaft at the robot's home posture, and the tool
calibration is taken from the URDFs, so a written cell is calibrated exactly.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from surg_core import load_chain, load_instrument, load_robot
from surg_core.replace_file import fixed_decimals, one_line, yaml_text
from surg_core.urdf import fixed_transform

Matrix = NDArray[np.float64]

CALIBRATION_DATE = "2026-11-21"
"""Date of a generated calibration: a constant, so that the same input gives the same file."""
FARTHEST = 2.0
"""Largest coordinate of a trocar point in the base frame that the core reads [m]."""


@dataclass(frozen=True)
class HomePose:
    """Where the instrument is when the robot is at home; vectors in the robot base frame B."""

    X_BF: Matrix  # (4, 4) flange pose
    s_F: Matrix  # (3,) unit shaft axis in the flange frame
    p_FTip: Matrix  # (3,) tip in the flange frame [m]
    s_B: Matrix  # (3,) unit shaft axis
    p_BTip: Matrix  # (3,) tip [m]
    p_BRcm: Matrix  # (3,) trocar point on the shaft [m]


@dataclass(frozen=True)
class ArmPlan:
    """One arm of a cell to be written."""

    robot_yaml: Path  # the robot's YAML, from anywhere
    instrument_yaml: Path
    depth: float = 0.120  # insertion depth of the tip at home [m], 0.005 to 0.5
    base_xyz: Sequence[float] = (0.0, 0.0, 0.0)  # (3,) robot base in the world [m]
    base_rpy: Sequence[float] = (0.0, 0.0, 0.0)  # (3,) its roll, pitch, yaw [rad]
    # (n,) home posture instead of the robot's own [rad]; None: the robot's own
    home: Sequence[float] | None = None
    home_reason: str = ""  # why, in one line
    # tightened limits by name, each with its value and the reason
    limits: Mapping[str, tuple[float, str]] = field(default_factory=dict)


def home_pose(
    robot_yaml: Path,
    instrument_yaml: Path,
    depth: float = 0.120,
    home: Sequence[float] | None = None,
) -> HomePose:
    """Pose of the instrument at the robot's home posture, with the trocar on its shaft.

    ``depth`` is the insertion depth of the tip at home [m], 0.005 to 0.5; ``home`` another home
    posture than the robot's own (n,) [rad].

    Raises:
        ConfigError: A YAML is invalid, or a URDF does not hold what it names.
        ValueError: depth is out of range, or the home posture does not fit or reaches too far.
    """
    if not 0.005 <= depth <= 0.5:
        raise ValueError(f"depth: {depth} m; allowed: 0.005 to 0.5 m")
    robot, instrument = load_robot(robot_yaml), load_instrument(instrument_yaml)
    names = robot.joint_names
    angles = robot.home if home is None else np.array(home, dtype=np.float64)
    if len(names) != len(angles):
        raise ValueError(
            f"{robot_yaml}: joints.home: {len(angles)} values; allowed: {len(names)}, one per name"
        )
    arm = load_chain(robot)
    X_FTip = fixed_transform(
        instrument_yaml.parent / instrument.urdf,
        instrument.mount_link,
        instrument.tip_link,
    )
    X_BF = np.asarray(arm.forward(angles))
    X_BTip = X_BF @ X_FTip
    s_B = X_BTip[:3, 2]
    p_BRcm = X_BTip[:3, 3] - depth * s_B
    if not np.abs(p_BRcm).max() <= FARTHEST:
        raise ValueError(
            f"{robot_yaml}: joints.home: the trocar would be {np.abs(p_BRcm).max():.2f} m from the "
            f"base along an axis; allowed are {FARTHEST:g}: bend the arm there, then let ./surg "
            "robot home FILE find a better one"
        )
    return HomePose(
        X_BF=X_BF,
        s_F=X_FTip[:3, 2],
        p_FTip=X_FTip[:3, 3],
        s_B=s_B,
        p_BTip=X_BTip[:3, 3],
        p_BRcm=p_BRcm,
    )


def make_cell(
    robot_yaml: Path,
    out_dir: Path,
    instrument_yaml: Path,
    depth: float = 0.120,
    arm: str = "PSM1",
) -> Path:
    """Writes a one-arm cell for a robot; arguments and errors as of `make_cell_of`."""
    return make_cell_of(out_dir, {arm: ArmPlan(robot_yaml, instrument_yaml, depth)})


def make_cell_of(out_dir: Path, plans: Mapping[str, ArmPlan], note: str = "") -> Path:
    """Writes a cell: cell.yaml and two calibrations for each arm; returns the path of cell.yaml.

    Args:
        out_dir: Folder to write; made if missing, its files replaced. Its name is the cell's name.
        plans: By CRTK name, in the order in which the arms shall stand in the file.
        note: Further comment lines for the head of the file.

    Raises:
        ConfigError: A YAML is invalid, or a URDF does not hold what it names.
        ValueError: There is no arm, or a depth is out of range.
        OSError: The folder cannot be written.
    """
    if not plans:
        raise ValueError(f"{out_dir}: no arms; a cell needs at least one")
    poses = {
        name: home_pose(
            plan.robot_yaml,
            plan.instrument_yaml,
            plan.depth,
            None if plan.home is None else _rounded(plan.home),
        )
        for name, plan in plans.items()
    }
    calibration = out_dir / "calibration"
    calibration.mkdir(parents=True, exist_ok=True)
    count = "One simulated arm" if len(plans) == 1 else f"{len(plans)} simulated arms"
    lines = [f"# {count}. Written by surg_description.make_cell."]
    lines += [f"# {line}" for line in note.splitlines()]
    lines += [
        "format: surg_cell/1",
        f"name: {yaml_text(out_dir.resolve().name)}",
        "network: loopback  # every port stays on this machine",
        "arms:",
    ]
    for name, plan in plans.items():
        lines += _arm_lines(name, plan, out_dir)
        pose = poses[name]
        (calibration / f"tool_{name}.yaml").write_text(
            "# Shaft axis and tip in the flange frame, taken from the URDFs: exact, not measured.\n"
            "format: surg_tool/1\n"
            f"shaft_axis: {fixed_decimals(pose.s_F)}  # unit vector, flange to tip\n"
            f"tip: {fixed_decimals(pose.p_FTip)}  # m\n" + _evidence(),
            encoding="utf-8",
        )
        (calibration / f"trocar_{name}.yaml").write_text(
            "# Trocar point in the robot base frame: on the shaft at home, the tip "
            f"{plan.depth:g} m deep.\n"
            "format: surg_trocar/1\n"
            f"point: {fixed_decimals(pose.p_BRcm)}  # m\n" + _evidence(),
            encoding="utf-8",
        )
    cell = out_dir / "cell.yaml"
    cell.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return cell


def _arm_lines(name: str, plan: ArmPlan, folder: Path) -> list[str]:
    lines = [
        f"  {yaml_text(name)}:",
        f"    robot: {_relative(plan.robot_yaml, folder)}",
        f"    instrument: {_relative(plan.instrument_yaml, folder)}",
        "    link: simulator",
        "    base:  # pose of the robot base in the world [m, rad]",
        f"      xyz: {_short(plan.base_xyz)}",
        f"      rpy: {_short(plan.base_rpy)}",
    ]
    if plan.home is not None:
        lines += [
            f"    # rad; {one_line(plan.home_reason) or 'not the home posture of the robot file'}"
        ]
        lines += [f"    home: {_short(plan.home)}"]
    if not plan.limits:
        return [*lines, "    limits: {}  # a cell may only tighten"]
    lines += ["    limits:  # a cell may only tighten"]
    return lines + [
        f"      {limit}: {value:g}  # {one_line(reason)}"
        for limit, (value, reason) in plan.limits.items()
    ]


def _evidence() -> str:
    return (
        "residual: 0.0  # m; computed, not measured\n"
        "n: 1\n"
        "condition: 1.0\n"
        f'date: "{CALIBRATION_DATE}"\n'
        "source: computed\n"
    )


def _rounded(values: Sequence[float]) -> list[float]:
    """To what the file says: 1e-4 m or rad. Adding 0.0 turns -0.0 into 0.0."""
    return [round(float(value), 4) + 0.0 for value in values]


def _short(values: Sequence[float]) -> str:
    return "[" + ", ".join(str(value) for value in _rounded(values)) + "]"


def _relative(path: Path, folder: Path) -> str:
    return yaml_text(os.path.relpath(path.resolve(), folder.resolve()))
