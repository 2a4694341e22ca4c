"""``force_sensor_<arm>.yaml`` beside ``cell.yaml``, surg_force_sensor/1: a sensor at the flange.

Range, noise, frame and rate of the six-axis sensor between an arm's flange and its tool. A cell
with such a file has the sensor. The C++ controller reads the key ``required`` alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from surg_core._core import Document, read_document
from surg_core.checked_document import CheckedDocument
from surg_core.config import PathLike
from surg_core.transforms import FloatArray

FORMAT = "surg_force_sensor/1"
READINGS = ("tool_on_sensor", "sensor_on_tool")
"""What a positive number means: what the tool exerts on the sensor, or the opposite."""
LARGEST = 10_000.0
"""[N, N m] No sensor at a flange measures more."""
FARTHEST = 0.3
"""[m] Of the sensor's origin from the flange."""
SLOWEST, FASTEST = 50.0, 8000.0
"""[1/s]"""


@dataclass(frozen=True, eq=False)
class ForceSensor:
    """A sensor between flange and tool.

    Attributes:
        name: Of its kind.
        rate: Readings in a second.
        largest: (6,) range; a reading there is saturated [N, N m].
        noise: (6,) standard deviation of a reading.
        drift: (6,) standard deviation by which the zero has moved after an hour.
        sign: 1: readings are what the tool exerts on the sensor; -1: the opposite.
        required: Whether the arm pauses while a force is not known.
        X_FS: (4, 4) the sensor's frame in the flange, by its drawing [m].
        bias: (6,) of the simulated sensor; a real one has its own.
        turn: (3,) rotation vector by which the simulated sensor is mounted otherwise than drawn
            [rad].
    """

    name: str
    rate: float
    largest: FloatArray
    noise: FloatArray
    drift: FloatArray
    sign: float
    required: bool
    X_FS: FloatArray
    bias: FloatArray
    turn: FloatArray


def parse_sensor(document: Document) -> ForceSensor:
    """The content of a sensor's file, checked.

    Raises:
        ConfigError: A key is missing, unknown or out of its range; names file, line, key, value
            and what is allowed.
    """
    doc = CheckedDocument(document)
    doc.choice("format", (FORMAT,))
    sensor = ForceSensor(
        name=doc.text("name", "a name"),
        rate=doc.number("rate", SLOWEST, FASTEST, "1/s"),
        largest=_positive(doc, "range"),
        noise=_positive(doc, "noise"),
        drift=_positive(doc, "drift", or_zero=True),
        sign=1.0 if doc.choice("reading", READINGS) == READINGS[0] else -1.0,
        required=doc.flag("required"),
        X_FS=doc.pose(FARTHEST),
        bias=_simulated(doc, "simulated.bias", 6, LARGEST, "N, N m"),
        turn=_simulated(doc, "simulated.turn", 3, 0.2, "rad"),
    )
    doc.finish()
    return sensor


def load_sensor(path: PathLike) -> ForceSensor:
    """Read a sensor's YAML; errors as :func:`parse_sensor`."""
    return parse_sensor(read_document(path))


def _positive(doc: CheckedDocument, key: str, or_zero: bool = False) -> FloatArray:
    """Six numbers, forces first [N], then moments [N m]."""
    values = doc.numbers(key, 6, LARGEST, "N, N m")
    good = (values >= 0.0).all() if or_zero else (values > 0.0).all()
    if not good:
        allowed = "numbers of 0 or more" if or_zero else "positive numbers"
        raise doc.refusal(key, f"holds {values.min():g}", allowed)
    return values


def _simulated(doc: CheckedDocument, key: str, n: int, bound: float, unit: str) -> FloatArray:
    return doc.numbers(key, n, bound, unit) if doc.has(key) else np.zeros(n)
