"""Reads robot, instrument, calibration and cell files; the one reader is C++ (``src/files``).

The schema stands in ``src/config``. Plain scalars are read by the rules of YAML 1.2: numbers are
numbers also in the form ``1e-3``, ``true`` and ``false`` are truth values, everything else is text,
dates included.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from surg_core._core import (
    ArmSetup,
    CellConfig,
    CellHardware,
    Chain,
    Fixture,
    InstrumentConfig,
    Limits,
    LinkConfig,
    RobotConfig,
    ToolCalibration,
    TrocarCalibration,
    UrKinematics,
    cell_file_of,
    load_arm,
    parse_cell,
    read_document,
)
from surg_core.transforms import FloatArray

PathLike = str | os.PathLike[str]
Value = bool | float | str | list[float] | list[str]


@dataclass(frozen=True)
class Arm:
    """One arm of a cell with everything that its nodes need.

    Attributes:
        name: CRTK name, for example ``PSM1``.
        link: what moves it, for example ``simulator``.
        robot: the robot's YAML, with the cell's home posture where it has one, as its link drives
            it.
        instrument: the instrument's YAML.
        limits: the robot's limits with the cell's tightened ones put in.
        tool: calibrated shaft axis and tip in the flange frame.
        fixtures: virtual fixtures, in the robot base frame.
        trocar: taught trocar point in the robot base frame.
        X_WB: ``(4, 4)`` robot base in the world, read-only: as measured in
            ``calibration/base_<arm>.yaml`` where that file is, else as stated.
        X_WB_stated: ``(4, 4)`` as ``cell.yaml`` states it. The simulator builds the arm there, and
            nobody else reads it.
        chain: joints from base link to flange link, with the arm's own kinematics where known.
        urdf_path: the robot's URDF, absolute.
        instrument_urdf: the instrument's URDF, absolute.
        link_config: parameters of what moves it.
        hardware: what the cell states of a real or emulated arm; None: it is simulated, or its link
            is started by hand.
        driver: folder with the driver of a link from outside the platform, absolute.
        link_settings: section ``settings`` of the link's YAML, for the driver.
        kinematics: the arm's own, which the chain has; None: the drawing's.
        force_sensor: ``force_sensor_<arm>.yaml`` beside the cell's file, absolute: the sensor
            between flange and tool; None: there is none.
    """

    name: str
    link: str
    robot: RobotConfig
    instrument: InstrumentConfig
    limits: Limits
    fixtures: tuple[Fixture, ...]
    tool: ToolCalibration
    trocar: TrocarCalibration
    X_WB: FloatArray
    X_WB_stated: FloatArray
    chain: Chain
    urdf_path: Path
    instrument_urdf: Path
    link_config: LinkConfig
    hardware: CellHardware | None
    driver: Path | None
    link_settings: Mapping[str, Value]
    kinematics: UrKinematics | None
    force_sensor: Path | None = None


@dataclass(frozen=True)
class Cell:
    """A user's whole system, read once.

    Attributes:
        config: what cell.yaml states.
        arms: arms by name, in the file's order.
        folder: the cell's folder, absolute.
    """

    config: CellConfig
    arms: Mapping[str, Arm]
    folder: Path


def load_cell(path: PathLike) -> Cell:
    """Reads a cell with everything it refers to.

    Args:
        path: the cell's folder, or its cell.yaml.

    Raises:
        ConfigError: with file, line, key, value and what is allowed, for the cell or any file that
            it names.
    """
    file = cell_file_of(os.fspath(path))
    config = parse_cell(read_document(file))
    arms = {arm.name: _arm(load_arm(file, arm.name), Path(file)) for arm in config.arms}
    return Cell(config=config, arms=MappingProxyType(arms), folder=Path(file).parent)


def _arm(setup: ArmSetup, cell_file: Path) -> Arm:
    stated = setup.arm
    force_sensor = cell_file.parent / f"force_sensor_{stated.name}.yaml"
    return Arm(
        name=stated.name,
        link=stated.link,
        robot=setup.robot,
        instrument=setup.instrument,
        limits=setup.limits,
        fixtures=stated.fixtures,
        tool=setup.tool,
        trocar=setup.trocar,
        X_WB=setup.X_WB,
        X_WB_stated=setup.X_WB_stated,
        chain=setup.chain,
        urdf_path=Path(setup.robot_urdf),
        instrument_urdf=Path(setup.instrument_urdf),
        link_config=setup.link,
        hardware=stated.hardware,
        driver=Path(setup.driver) if setup.driver else None,
        link_settings=MappingProxyType(setup.link_settings),
        kinematics=setup.kinematics,
        force_sensor=force_sensor if force_sensor.exists() else None,
    )
