"""``calibration/force_<arm>.yaml``, surg_force/1: what a free tool does to its force sensor."""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from pathlib import Path

from surg_core._core import Document, read_document
from surg_core.checked_document import CheckedDocument
from surg_core.config import PathLike
from surg_core.force.compensation import PARAMETERS, ToolLoad
from surg_core.force.load_solver import LEAST_POSTURES
from surg_core.force.sensor_file import FARTHEST
from surg_core.reading.pose_evidence import SOURCES, check_measured_with
from surg_core.replace_file import exact_number, exact_numbers, exact_rows, one_line, replace_file
from surg_core.transforms import matrix_to_quaternion_xyzw

FORMAT = "surg_force/1"
CURE = "./surg calibrate CELL force"
HEAVIEST = 20.0
"""[kg]"""
LARGEST_BIAS = 1000.0
"""[N, N m]"""
LARGEST_RESIDUAL = 10.0
"""In standard deviations of the sensor's file; what the reader takes."""


@dataclass(frozen=True, eq=False)
class ForceCalibration:
    """A measured load with its evidence.

    Attributes:
        load: With its covariance.
        residual: Of the fit, in standard deviations; 1 is best.
        condition: Of the postures; 1 is best.
        n: Number of postures.
        date: Day of the measurement.
        zeroed: When the bias was measured, UTC, such as ``2026-11-23T13:45:00``.
        source: ``measured`` or ``simulated``.
        tool_sha256: Of ``tool_<arm>.yaml`` at that time.
        sensor_sha256: Of the sensor's YAML.
    """

    load: ToolLoad
    residual: float
    condition: float
    n: int
    date: str
    zeroed: str
    source: str
    tool_sha256: str
    sensor_sha256: str

    def hours_since_zero(self, now: datetime.datetime) -> float:
        """Hours from the zero to a time in UTC; 0 where the clock is behind."""
        then = datetime.datetime.fromisoformat(self.zeroed).replace(tzinfo=datetime.UTC)
        return max(0.0, (now - then).total_seconds() / 3600.0)


def parse_force(document: Document) -> ForceCalibration:
    """The content of a surg_force/1 file, checked.

    Raises:
        ConfigError: A key is missing, unknown or out of its range; names file, line, key, value
            and what is allowed.
    """
    doc = CheckedDocument(document)
    doc.choice("format", (FORMAT,))
    load = ToolLoad(
        mass=doc.number("mass", 1e-3, HEAVIEST, "kg"),
        p_SCom=doc.numbers("centre", 3, FARTHEST, "m"),
        bias=doc.numbers("bias", 6, LARGEST_BIAS, "N, N m"),
        R_FS=doc.rotation(),
        p_FS=doc.numbers("position", 3, FARTHEST, "m"),
        covariance=doc.any_covariance(
            "covariance", (PARAMETERS,), 1e3, 1e-12, f"Measure again: {CURE}"
        ),
    )
    found = ForceCalibration(
        load=load,
        residual=doc.number("residual", 0.0, LARGEST_RESIDUAL, ""),
        condition=doc.number("condition", 1.0, 1e6, ""),
        n=doc.count("n", LEAST_POSTURES),
        date=doc.date(),
        zeroed=doc.text("zeroed", 'UTC, "2026-11-23T13:45:00"', r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d"),
        source=doc.choice("source", SOURCES),
        tool_sha256=doc.sha256("tool_sha256"),
        sensor_sha256=doc.sha256("sensor_sha256"),
    )
    doc.finish()
    try:
        found.hours_since_zero(datetime.datetime.now(datetime.UTC))
    except ValueError as error:
        raise doc.refusal("zeroed", found.zeroed, 'UTC, "2026-11-23T13:45:00"') from error
    return found


def load_force(path: PathLike) -> ForceCalibration:
    """Read ``force_<arm>.yaml``; errors as :func:`parse_force`."""
    return parse_force(read_document(path))


def write_force(path: PathLike, found: ForceCalibration, note: str) -> None:
    """Write a surg_force/1 file; the old one stays as ``<name>.previous``.

    Raises:
        ConfigError: The reader would refuse it; nothing is replaced then.
        OSError: It cannot be written.
    """
    load = found.load
    text = (
        f"# {one_line(note)}\n"
        f"format: {FORMAT}\n"
        f"mass: {exact_number(load.mass)}  # kg, of everything on the sensor\n"
        f"centre: {exact_numbers(load.p_SCom)}  # m, p_SCom: centre of mass in the sensor\n"
        f"bias: {exact_numbers(load.bias)}  # N, N m\n"
        f"position: {exact_numbers(load.p_FS)}  # m, p_FS: the sensor's origin, by its drawing\n"
        f"quaternion: {exact_numbers(matrix_to_quaternion_xyzw(load.R_FS))}  # of R_FS\n"
        "# mass, centre, bias, turn phi of R_true = R_FS exp([phi])\n"
        f"covariance: {exact_rows(load.covariance)}\n"
        f"residual: {exact_number(found.residual)}  # standard deviations, rms\n"
        f"n: {found.n}\n"
        f"condition: {exact_number(max(found.condition, 1.0))}\n"
        f'date: "{one_line(found.date)}"\n'
        f'zeroed: "{one_line(found.zeroed)}"  # UTC\n'
        f"source: {one_line(found.source)}\n"
        f'tool_sha256: "{one_line(found.tool_sha256)}"  # of tool_<arm>.yaml\n'
        f'sensor_sha256: "{one_line(found.sensor_sha256)}"\n'
    )
    replace_file(Path(path), text, load_force)


def check_current(
    found: ForceCalibration, file: PathLike, tool_file: Path, sensor_file: Path
) -> None:
    """Refuse a calibration that is older than its tool or its sensor's file.

    Raises:
        ConfigError: With both files and the cure.
    """
    check_measured_with(
        file,
        (
            ("tool_sha256", found.tool_sha256, tool_file),
            ("sensor_sha256", found.sensor_sha256, sensor_file),
        ),
        "it has changed since the force was calibrated",
        f"Repeat {CURE}, or put back that file",
    )
