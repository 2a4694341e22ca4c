"""Reads robot, instrument, calibration and cell files; the schema itself is C++ (``src/config``).

A file is parsed into PyYAML's node tree (no objects are ever constructed) and flattened to dotted
keys, with the line of each key. Plain scalars are read by the rules of YAML 1.2, as the C++ nodes
read them: numbers are numbers also in the form ``1e-3``, ``true`` and ``false`` are truth values,
everything else is text, dates included.
"""

from __future__ import annotations

import datetime
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
import yaml  # type: ignore[import]

from surg_core._core import (
    CellArm,
    CellConfig,
    CellHardware,
    Chain,
    ConfigError,
    Document,
    Fixture,
    InstrumentConfig,
    Limits,
    LinkConfig,
    RobotConfig,
    ToolCalibration,
    TrocarCalibration,
    UrKinematics,
    check_base,
    check_hardware,
    check_kinematics,
    check_tool,
    link_file,
    parse_base,
    parse_cell,
    parse_instrument,
    parse_kinematics,
    parse_link,
    parse_robot,
    parse_tool,
    parse_trocar,
    simulator_link,
    tighten,
    unknown_link,
    with_home,
    with_kinematics,
    with_link,
    with_measured_lag,
)
from surg_core.transforms import FloatArray, make_pose
from surg_core.urdf import chain_from_urdf, fixed_transform

SIMULATOR = "simulator"
"""The link of an arm that the simulator drives."""
TIP_OFF = 0.02
"""[m] Of a calibrated tip from its instrument's drawing. A clamp holds a shaft to some mm."""

PathLike = str | os.PathLike[str]
Value = bool | float | str | list[float] | list[str]

_MOST_KEYS = 10_000  # a few nested aliases could otherwise unfold without end
_NUMBER = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")


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


def load_robot(path: PathLike) -> RobotConfig:
    """Reads a robot YAML.

    Raises:
        ConfigError: with file, line, key, value and what is allowed.
    """
    return parse_robot(read_document(path))


def load_instrument(path: PathLike) -> InstrumentConfig:
    """Reads an instrument YAML; errors as :func:`load_robot`."""
    return parse_instrument(read_document(path))


def load_tool(path: PathLike) -> ToolCalibration:
    """Reads a tool calibration; errors as :func:`load_robot`."""
    return parse_tool(read_document(path))


def load_trocar(path: PathLike) -> TrocarCalibration:
    """Reads a trocar calibration; errors as :func:`load_robot`."""
    return parse_trocar(read_document(path))


def load_kinematics(path: PathLike) -> UrKinematics:
    """Reads an arm's own kinematics; errors as :func:`load_robot`."""
    return parse_kinematics(read_document(path))


def kinematics_of(text: str, file: str) -> UrKinematics:
    """An arm's own kinematics from the text of their file; ``file`` is named in errors."""
    return parse_kinematics(Document(file, *flatten(text, file)))


def load_cell(path: PathLike) -> Cell:
    """Reads a cell with everything it refers to.

    Args:
        path: the cell's folder, or its cell.yaml.

    Raises:
        ConfigError: as :func:`load_robot`, for the cell or any file it names.
    """
    file = Path(path)
    if file.is_dir():
        file = file / "cell.yaml"
    file = file.absolute()
    config = parse_cell(read_document(file))
    arms = {stated.name: _load_arm(stated, config, file) for stated in config.arms}
    return Cell(config=config, arms=MappingProxyType(arms), folder=file.parent)


def _load_arm(stated: CellArm, config: CellConfig, file: Path) -> Arm:
    """One arm with everything that its cell, the file, refers to."""
    robot_file = _named_file(file, f"arms.{stated.name}.robot", stated.robot)
    instrument_file = _named_file(file, f"arms.{stated.name}.instrument", stated.instrument)
    robot = with_home(load_robot(robot_file), stated, str(file))
    link_config, driver, link_settings = _load_link(stated, file)
    robot = with_link(robot, link_config)
    instrument = load_instrument(instrument_file)
    urdf = _beside(robot_file, robot.urdf)
    instrument_urdf = _beside(instrument_file, instrument.urdf)
    try:
        chain = chain_from_urdf(urdf, robot.base_link, robot.flange_link, robot.joint_names)
    except ConfigError as error:
        raise ConfigError(f"{robot_file}: urdf: {error}") from error
    try:
        X_FTip = fixed_transform(instrument_urdf, instrument.mount_link, instrument.tip_link)
    except ConfigError as error:
        raise ConfigError(f"{instrument_file}: urdf: {error}") from error
    limits = tighten(robot.limits, stated, str(file))
    tool_file = file.parent / "calibration" / f"tool_{stated.name}.yaml"
    tool = load_tool(tool_file)
    check_tool(tool, limits, str(tool_file))
    trocar = load_trocar(file.parent / "calibration" / f"trocar_{stated.name}.yaml")
    today = datetime.date.today().isoformat()
    check_hardware(stated, robot, instrument, tool, trocar, str(file), today)
    _check_instrument(stated, tool, X_FTip[:3, 3], tool_file, instrument_file)
    chain, kinematics = _own_chain(chain, stated, robot, file)
    X_WB_stated = make_pose(stated.base_xyz, stated.base_rpy)
    X_WB_stated.setflags(write=False)
    return Arm(
        name=stated.name,
        link=stated.link,
        robot=robot,
        instrument=instrument,
        limits=limits,
        fixtures=stated.fixtures,
        tool=tool,
        trocar=trocar,
        X_WB=_measured_base(stated, config, file, X_WB_stated),
        X_WB_stated=X_WB_stated,
        chain=chain,
        urdf_path=urdf,
        instrument_urdf=instrument_urdf,
        link_config=link_config,
        hardware=stated.hardware,
        driver=driver,
        link_settings=link_settings,
        kinematics=kinematics,
        force_sensor=_if_there(file.parent / f"force_sensor_{stated.name}.yaml"),
    )


def _check_instrument(
    arm: CellArm,
    tool: ToolCalibration,
    p_FTip: FloatArray,
    tool_file: Path,
    instrument_file: Path,
) -> None:
    """Refuse a real arm whose tool was calibrated with another instrument.

    ``p_FTip`` is the tip by the instrument's drawing, in the flange frame [m].
    """
    hardware = arm.hardware
    if hardware is None or hardware.emulated or hardware.commissioning:
        return
    away = float(np.linalg.norm(tool.p_FTip - p_FTip))
    if not away <= TIP_OFF:
        raise ConfigError(
            f"arms.{arm.name}.hardware: {tool_file}: the tip is {1e3 * away:.0f} mm from that of "
            f"{instrument_file}; allowed are {1e3 * TIP_OFF:.0f} mm. Another instrument was "
            "calibrated: name it in the cell, or calibrate this one: ./surg calibrate CELL tool"
        )


def _load_link(
    arm: CellArm, cell_file: Path
) -> tuple[LinkConfig, Path | None, Mapping[str, Value]]:
    """A link's parameters, the folder of its driver, and the settings for that driver."""
    if arm.link == SIMULATOR:
        return simulator_link(), None, MappingProxyType({})
    file = _beside(cell_file, link_file(arm))
    if not file.is_file():
        raise ConfigError(unknown_link(arm, str(cell_file), str(file)))
    document = read_document(file)
    link = parse_link(document)
    settings = {
        key.removeprefix("settings."): value
        for key, value in document.values.items()
        if key.startswith("settings.")
    }
    driver = _beside(file, link.driver) if link.driver else None
    return with_measured_lag(link, arm), driver, MappingProxyType(settings)


def _measured_base(
    arm: CellArm, config: CellConfig, cell_file: Path, stated: FloatArray
) -> FloatArray:
    """X_WB from ``base_<arm>.yaml``; the stated one where the cell has no such file."""
    file = cell_file.parent / "calibration" / f"base_{arm.name}.yaml"
    if not file.exists():
        return stated
    base = parse_base(read_document(file))
    check_base(base, arm, config)
    return base.X_WB


def _own_chain(
    drawn: Chain, arm: CellArm, robot: RobotConfig, cell_file: Path
) -> tuple[Chain, UrKinematics | None]:
    """The chain with the arm's own kinematics, where the cell has their file."""
    file = cell_file.parent / "calibration" / f"kinematics_{arm.name}.yaml"
    if not file.exists():
        return drawn, None
    own = load_kinematics(file)
    check_kinematics(own, arm, robot)
    try:
        return with_kinematics(drawn, own), own
    except ValueError as error:
        raise ConfigError(f"{file}: {error}") from error


def _if_there(file: Path) -> Path | None:
    return file if file.exists() else None


def _beside(file: Path, name: str) -> Path:
    """A path that a file states relative to its own folder."""
    return (file.parent / name).resolve()


def _named_file(cell_file: Path, key: str, name: str) -> Path:
    """A file that a cell names; a ConfigError with the cure if it is not there.

    A cell that was copied to another folder takes its relative paths along.
    """
    file = _beside(cell_file, name)
    if not file.exists():
        line = read_document(cell_file).lines[key]
        raise ConfigError(
            f"{cell_file}:{line}: {key}: '{name}': there is no {file}; a relative path starts at "
            "the cell's folder. In a cell that was copied, write the file's absolute path"
        )
    return file


def read_document(path: PathLike) -> Document:
    """Reads and flattens a YAML file.

    Raises:
        ConfigError: for a file that is missing, unreadable, no YAML, not a mapping, or that says
            a key twice.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is not UTF-8 text: {error.reason}") from error
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
    values, lines = flatten(text, str(path))
    return Document(str(path), values, lines)


def flatten(text: str, file: str) -> tuple[dict[str, Value], dict[str, int]]:
    """YAML text as ``{"limits.cone": 1.0, ...}`` and the line, from 1, of each key.

    Args:
        text: one YAML document.
        file: named in errors.

    Raises:
        ConfigError: see :func:`read_document`.
    """
    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"{file}:{mark.line + 1}" if mark else file
        raise ConfigError(f"{where}: is not YAML: {error.problem or error}") from error
    except yaml.YAMLError as error:  # characters that YAML does not allow
        raise ConfigError(f"{file}: is not YAML: {error}") from error
    except RecursionError as error:
        raise ConfigError(f"{file}: is nested too deeply") from error
    if not isinstance(root, yaml.MappingNode):
        raise ConfigError(f"{file}: is not a mapping; 'key: value' lines are needed")
    values: dict[str, Value] = {}
    lines: dict[str, int] = {}
    _flatten(root, "", file, values, lines, [])
    return values, lines


def _flatten(
    node: yaml.MappingNode,
    prefix: str,
    file: str,
    values: dict[str, Value],
    lines: dict[str, int],
    above: list[yaml.Node],
) -> None:
    for key_node, value_node in node.value:
        line = key_node.start_mark.line + 1
        name = key_node.value if isinstance(key_node, yaml.ScalarNode) else ""
        if not name or "." in name:
            raise ConfigError(f"{file}:{line}: {prefix}{name}: a key must be a text without dots")
        key = prefix + name
        if key in lines:
            raise ConfigError(f"{file}:{line}: {key}: is said twice; first in line {lines[key]}")
        if len(lines) >= _MOST_KEYS:
            raise ConfigError(f"{file}:{line}: {key}: more than {_MOST_KEYS} keys")
        lines[key] = line
        if isinstance(value_node, yaml.MappingNode):
            if value_node in above:
                raise ConfigError(f"{file}:{line}: {key}: contains itself")
            _flatten(value_node, key + ".", file, values, lines, [*above, node, value_node])
        elif isinstance(value_node, yaml.SequenceNode):
            values[key] = _list(value_node, f"{file}:{line}: {key}")
        else:
            values[key] = _scalar(value_node, f"{file}:{line}: {key}")


def _list(node: yaml.SequenceNode, where: str) -> list[float] | list[str]:
    items = [
        _scalar(item, where) if isinstance(item, yaml.ScalarNode) else None for item in node.value
    ]
    numbers = [item for item in items if isinstance(item, float)]
    texts = [item for item in items if isinstance(item, str)]
    if len(numbers) == len(items):
        return numbers
    if len(texts) == len(items):
        return texts
    raise ConfigError(f"{where}: a list may hold numbers or texts, all of one kind")


def _scalar(node: yaml.ScalarNode, where: str) -> bool | float | str:
    text: str = node.value
    if node.style is not None:  # quoted or block: text, whatever it looks like
        return text
    if text in ("", "~", "null", "Null", "NULL"):
        raise ConfigError(f"{where}: is empty; a value is needed")
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    if _NUMBER.fullmatch(text):
        return float(text)
    if _NOT_FINITE.fullmatch(text):
        return float(text.replace(".", "", 1))
    return text
