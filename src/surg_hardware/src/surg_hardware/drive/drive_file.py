"""``drive_<arm>.yaml`` beside ``cell.yaml``, surg_drive/1: the motors that turn an instrument.

A cell whose arm has ``tool_link: drive`` has such a file. Angles of a motor are those behind its
gear, in the direction of ``sign``, and zero where homing leaves it.
"""

from __future__ import annotations

import hashlib
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from surg_core import Cell, ConfigError, read_document
from surg_core.checked_document import CheckedDocument, FloatArray

FORMAT = "surg_drive/1"
JOINTS = ("pitch", "yaw", "jaw", "roll")
"""In the order of the topics; each has one motor, and only the jaw must be there."""
BAUDS = (1_000_000, 2_000_000, 3_000_000, 4_000_000)
"""[bit/s] Slower ones are too slow for 100 exchanges in a second."""
EMULATED = "emulated"
"""Stands in the place of a port: the emulator's pseudo-terminal of this cell and arm."""
LOST = ("hold", "open")
"""What the jaws do when the drive has failed, as far as their motor still obeys."""
SINGULAR = 1e3
"""A coupling of a larger condition number cannot be inverted in practice."""
LAST_ID = 252
FULL_TURNS = 20.0
"""[rad] Bound of every angle."""


@dataclass(frozen=True)
class Model:
    """A motor's model: its number in the control table, and its largest current [A]."""

    number: int
    largest_current: float


MODELS = {
    "XM430-W350": Model(1020, 1193 * 2.69e-3),
    "XM430-W210": Model(1030, 1193 * 2.69e-3),
    "XM540-W270": Model(1120, 2047 * 2.69e-3),
    "XM540-W150": Model(1130, 2047 * 2.69e-3),
}
"""They have position with a bound of the current, and a bus watchdog that holds the motor."""


@dataclass(frozen=True)
class Homing:
    """How a motor finds its zero: it turns against a stop of the instrument.

    Attributes:
        direction: 1 or -1, of the motor's angle.
        current: Its bound meanwhile [A].
        stop: Angle of the motor at the stop [rad].
        travel: It turns by so much at most [rad].
    """

    direction: float
    current: float
    stop: float
    travel: float


@dataclass(frozen=True)
class Motor:
    """One motor, and the joint of the same name.

    Attributes:
        joint: One of `JOINTS`.
        id: On the bus.
        model: One of `MODELS`.
        sign: 1 or -1: direction of its encoder.
        gear: Turns of the encoder for one turn behind the gear.
        lower, upper: Limits of the joint [rad].
        velocity: Largest, behind the gear [rad/s].
        current: Bound of its current [A]; that of the jaw's motor bounds the jaws' force.
        homing: How it finds its zero.
    """

    joint: str
    id: int
    model: str
    sign: float
    gear: float
    lower: float
    upper: float
    velocity: float
    current: float
    homing: Homing


@dataclass(frozen=True, eq=False)
class DriveFile:
    """A drive.

    Attributes:
        file: Where it stands.
        port: Of the serial line.
        emulated: Whether that is the emulator's.
        baud: [bit/s].
        motors: In the order of `JOINTS`.
        coupling: (n, n) joints = coupling @ motors, both [rad].
        when_lost: One of `LOST`.
        voltage: Smallest and largest [V].
        temperature: Largest [degC].
    """

    file: Path
    port: Path
    emulated: bool
    baud: int
    motors: tuple[Motor, ...]
    coupling: FloatArray
    when_lost: str
    voltage: tuple[float, float]
    temperature: float

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, in the order of the topics."""
        return tuple(motor.joint for motor in self.motors)

    def name(self, motor_id: int) -> str:
        """A motor in words: id and joint."""
        joints = [motor.joint for motor in self.motors if motor.id == motor_id]
        return f"motor {motor_id}" + (f" ({joints[0]})" if joints else "")


def load_drive(path: Path) -> DriveFile:
    """Read a drive's YAML.

    Raises:
        ConfigError: A key is missing, unknown or out of its range; names file, line, key, value
            and what is allowed.
    """
    doc = CheckedDocument(read_document(path))
    doc.choice("format", (FORMAT,))
    port = doc.text("port", f"a device such as /dev/ttyUSB0, or {EMULATED}")
    baud = int(doc.number("baud", 0.0, BAUDS[-1], "bit/s"))
    if baud not in BAUDS:
        raise doc.refusal("baud", str(baud), ", ".join(map(str, BAUDS)))
    low, high = doc.numbers("voltage", 2, 30.0, "V")
    if not 0.0 < low < high:
        raise doc.refusal("voltage", f"is {low:g} to {high:g} V", "smallest and largest, above 0 V")
    motors = tuple(_motor(doc, joint) for joint in JOINTS if _has(doc, joint))
    _check_ids(doc, motors)
    drive = DriveFile(
        file=path,
        port=emulated_port(path) if port == EMULATED else Path(port),
        emulated=port == EMULATED,
        baud=baud,
        motors=motors,
        coupling=_coupling(doc, motors),
        when_lost=doc.choice("when_lost", LOST),
        voltage=(float(low), float(high)),
        temperature=doc.number("temperature", 30.0, 80.0, "degC"),
    )
    doc.finish()
    return drive


def drive_of(cell: Cell, arm: str) -> DriveFile:
    """The drive of an arm of a cell, whose limits contain the ranges of the instrument's joints.

    Raises:
        ConfigError: The arm has none, or its file must not be used.
    """
    hardware, instrument = cell.arms[arm].hardware, cell.arms[arm].instrument
    if hardware is None or hardware.tool_link != "drive":
        raise ConfigError(
            f"{cell.folder / 'cell.yaml'}: arms.{arm}.hardware.tool_link: is not 'drive'; allowed: "
            f"drive, with drive_{arm}.yaml beside the cell"
        )
    drive = load_drive(cell.folder / f"drive_{arm}.yaml")
    ranges = {"jaw": (instrument.jaw_min, instrument.jaw_max)}
    if (wrist := instrument.wrist) is not None:
        turned = zip(("pitch", "yaw", "roll"), zip(wrist.min, wrist.max, strict=True), strict=True)
        ranges |= {joint: ends for joint, ends in turned if joint != "roll" or wrist.rolls}
        if set(drive.joints) != set(ranges):
            raise ConfigError(
                f"{drive.file}: motors: {', '.join(drive.joints)}; allowed: those that "
                f"{instrument.file} has: {', '.join(joint for joint in JOINTS if joint in ranges)}"
            )
    for motor in drive.motors:
        low, high = ranges.get(motor.joint, (0.0, 0.0))
        if low < motor.lower or high > motor.upper:
            raise ConfigError(
                f"{drive.file}: motors.{motor.joint}.limits: [{motor.lower:g}, {motor.upper:g}] "
                f"rad; allowed: limits that contain the instrument's, [{low:g}, {high:g}] rad"
            )
    return drive


def emulated_port(path: Path) -> Path:
    """The emulator's pseudo-terminal of a drive's file: one for each cell and arm."""
    name = hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:12]
    return Path(tempfile.gettempdir()) / f"surg_drive_{name}"


def _has(doc: CheckedDocument, joint: str) -> bool:
    return joint == "jaw" or doc.has(f"motors.{joint}.id")


def _motor(doc: CheckedDocument, joint: str) -> Motor:
    key = f"motors.{joint}."
    model = doc.choice(key + "model", tuple(MODELS))
    largest = MODELS[model].largest_current
    lower, upper = doc.numbers(key + "limits", 2, FULL_TURNS, "rad")
    if not lower <= 0.0 <= upper or lower == upper:
        text = "smallest and largest [rad] with 0 between them, where homing leaves the joint"
        raise doc.refusal(key + "limits", f"is [{lower:g}, {upper:g}]", text)
    current = doc.number(key + "current", 0.01, largest, "A")
    homing = Homing(
        direction=_sign(doc, key + "homing.direction"),
        current=doc.number(key + "homing.current", 0.01, current, "A"),
        stop=doc.number(key + "homing.stop", -FULL_TURNS, FULL_TURNS, "rad"),
        travel=doc.number(key + "homing.travel", 0.1, FULL_TURNS, "rad"),
    )
    if homing.stop * homing.direction < 0.0:
        rule = "a stop in that direction from zero, or 0"
        raise doc.refusal(key + "homing.stop", f"{homing.stop:g} is behind the motor's zero", rule)
    return Motor(
        joint=joint,
        id=doc.count(key + "id", 0, LAST_ID),
        model=model,
        sign=_sign(doc, key + "sign"),
        gear=doc.number(key + "gear", 0.05, 20.0, "turns of the motor for one behind the gear"),
        lower=float(lower),
        upper=float(upper),
        velocity=doc.number(key + "velocity", 0.1, 20.0, "rad/s"),
        current=current,
        homing=homing,
    )


def _sign(doc: CheckedDocument, key: str) -> float:
    value = doc.number(key, -1.0, 1.0, "")
    if value not in (-1.0, 1.0):
        raise doc.refusal(key, f"{value:g}", "1 or -1")
    return value


def _check_ids(doc: CheckedDocument, motors: tuple[Motor, ...]) -> None:
    seen: dict[int, str] = {}
    for motor in motors:
        if motor.id in seen:
            why = f"{motor.id}, which the motor of {seen[motor.id]} has too"
            raise doc.refusal(f"motors.{motor.joint}.id", why, "another id for each motor")
        seen[motor.id] = motor.joint


def _coupling(doc: CheckedDocument, motors: tuple[Motor, ...]) -> FloatArray:
    n = len(motors)
    rows = [doc.numbers(f"coupling.{motor.joint}", n, 10.0, "") for motor in motors]
    coupling = np.array(rows)
    if not np.linalg.cond(coupling) < SINGULAR:
        key = f"coupling.{motors[-1].joint}"
        rule = "rows of which none follows from the others: joints = coupling x motors"
        raise doc.refusal(key, "makes the coupling singular", rule)
    return coupling
