"""Reads a calibration file key by key; each refusal names file, line, key, value and the cure.

The rules that all registrations share stand here once: unit quaternions, covariances, dates,
SHA-256 hashes. Keys that nobody asks for are refused.
"""

from __future__ import annotations

import datetime
import math
import re
from collections.abc import Sequence

import numpy as np

from surg_core._core import ConfigError, Document, read_document
from surg_core.config import PathLike, Value
from surg_core.reading.pose_evidence import NO_HASH, SOURCES, Evidence
from surg_core.transforms import (
    FloatArray,
    quaternion_xyzw_to_matrix,
)

LARGEST_TURN_SD, LARGEST_SHIFT_SD = 0.35, 0.1
"""[rad, m] Standard deviations above which a registration says nothing."""
MOST_SAMPLES = 1_000_000


class CheckedDocument:
    """A flat document whose keys are asked for one by one."""

    def __init__(self, document: Document) -> None:
        """Start reading; :meth:`finish` refuses what nobody has asked for."""
        self.file: str = document.file
        self._values: dict[str, Value] = dict(document.values)
        self._lines: dict[str, int] = dict(document.lines)
        self._known: set[str] = set()

    @classmethod
    def read(cls, path: PathLike) -> CheckedDocument:
        """Read a file.

        Raises:
            ConfigError: It is missing or no YAML; see :func:`surg_core.read_document`.
        """
        return cls(read_document(path))

    def refusal(self, key: str, why: str, allowed: str, cure: str = "") -> ConfigError:
        """The error for a key: what is wrong, what is allowed, what to do."""
        line = f":{self._lines[key]}" if key in self._lines else ""
        text = f"{self.file}{line}: {key}: {why}; allowed: {allowed}"
        return ConfigError(f"{text}. {cure}" if cure else text)

    def _get(self, key: str, allowed: str) -> Value:
        self._known.add(key)
        if key not in self._values:
            raise self.refusal(key, "is missing", allowed)
        return self._values[key]

    def has(self, key: str) -> bool:
        """Whether the file states a key that may be left out."""
        return key in self._values

    def choice(self, key: str, choices: Sequence[str]) -> str:
        """One of the texts."""
        value = self._get(key, ", ".join(choices))
        if value not in choices:
            raise self.refusal(key, repr(value), ", ".join(choices))
        return str(value)

    def flag(self, key: str) -> bool:
        """True or false."""
        value = self._get(key, "true, false")
        if not isinstance(value, bool):
            raise self.refusal(key, repr(value), "true, false")
        return value

    def text(self, key: str, allowed: str, pattern: str = r"[^\n]*\S[^\n]*") -> str:
        """A text of one line that matches the pattern; ``allowed`` describes it for people."""
        value = self._get(key, allowed)
        if not isinstance(value, str) or not re.fullmatch(pattern, value):
            raise self.refusal(key, repr(value), allowed)
        return value

    def number(self, key: str, low: float, high: float, unit: str) -> float:
        """A number within bounds."""
        allowed = f"{low:g} to {high:g} {unit}".rstrip()
        value = self._get(key, allowed)
        # Written so that NaN is refused.
        if not isinstance(value, float) or not low <= value <= high:
            raise self.refusal(key, f"{value!r}", allowed)
        return value

    def count(self, key: str, least: int, most: int = MOST_SAMPLES) -> int:
        """A whole number within bounds."""
        allowed = f"a whole number, {least} to {most}"
        value = self._get(key, allowed)
        if not isinstance(value, float) or not least <= value <= most or value % 1 != 0:
            raise self.refusal(key, f"{value!r}", allowed)
        return int(value)

    def numbers(self, key: str, n: int | Sequence[int], bound: float, unit: str) -> FloatArray:
        """A list of n finite numbers within +-bound; n may be a choice of lengths."""
        lengths = (n,) if isinstance(n, int) else tuple(n)
        allowed = f"{' or '.join(map(str, lengths))} numbers, -{bound:g} to {bound:g} {unit}"
        value = self._get(key, allowed.rstrip())
        if not isinstance(value, list) or not all(isinstance(v, float) for v in value):
            raise self.refusal(key, repr(value), allowed.rstrip())
        found = np.array(value, dtype=np.float64)
        if len(found) not in lengths:
            raise self.refusal(key, f"has {len(found)} numbers", allowed.rstrip())
        if not (np.abs(found) <= bound).all():
            worst = next(v for v in value if not abs(float(v)) <= bound)
            raise self.refusal(key, f"holds {worst}", allowed.rstrip())
        return found

    def rotation(self, key: str = "quaternion") -> FloatArray:
        """(3, 3) of a unit quaternion x, y, z, w."""
        q = self.numbers(key, 4, 1.0 + 1e-6, "")
        length = float(np.linalg.norm(q))
        if not abs(length - 1.0) <= 1e-6:
            raise self.refusal(
                key,
                f"{q.tolist()} has length {length:.9g}",
                "x, y, z, w of length 1",
                "Divide the four numbers by that length, or measure again",
            )
        return quaternion_xyzw_to_matrix(q)

    def pose(self, bound: float) -> FloatArray:
        """(4, 4) of ``position`` [m], each within +-bound, and ``quaternion``."""
        X = np.eye(4)
        X[:3, 3] = self.numbers("position", 3, bound, "m")
        X[:3, :3] = self.rotation()
        X.setflags(write=False)
        return X

    def covariance(self, key: str = "covariance") -> FloatArray:
        """(6, 6) symmetric, positive definite, rotation first."""
        cure = "Measure again: this file does not state how good it is"
        C = self.any_covariance(key, (6,), 1.0, 1e-9, cure)
        sd = np.sqrt(np.diag(C))
        for part, bound, unit in (
            (sd[:3], LARGEST_TURN_SD, "rad"),
            (sd[3:], LARGEST_SHIFT_SD, "m"),
        ):
            if not part.max() <= bound:
                raise self.refusal(
                    key,
                    f"holds the standard deviation {part.max():.3g} {unit}",
                    f"at most {bound:g} {unit}",
                    cure,
                )
        return C

    def any_covariance(
        self, key: str, sides: Sequence[int], bound: float, least: float, cure: str
    ) -> FloatArray:
        """(m, m) symmetric, with positive variances.

        Args:
            key: Of the m * m numbers, row by row.
            sides: Allowed m.
            bound: Of each number.
            least: Every eigenvalue is larger, where each variance is scaled to 1.
            cure: What to do.
        """
        size = " or ".join(f"{m} x {m}" for m in sides)
        values = self.numbers(key, [m * m for m in sides], bound, f"({size}, row by row)")
        m = math.isqrt(len(values))
        C = values.reshape(m, m)
        if not np.abs(C - C.T).max() <= 1e-9 * np.abs(C).max():
            raise self.refusal(key, "is not symmetric", f"a symmetric {m} x {m} matrix", cure)
        variances = np.diag(C)
        if not (variances > 0.0).all():
            why = f"holds the variance {variances.min():g}"
            raise self.refusal(key, why, "positive variances", cure)
        sd = np.sqrt(variances)
        smallest = float(np.linalg.eigvalsh(C / np.outer(sd, sd)).min())
        if not smallest > least:
            why = f"has the eigenvalue {smallest:.3g} (scaled)"
            raise self.refusal(key, why, "a positive definite matrix", cure)
        C.setflags(write=False)
        return C

    def sha256(self, key: str, optional: bool = False) -> str:
        """64 hexadecimal digits, or `none` where that is allowed."""
        allowed = "64 hexadecimal digits" + (f", or {NO_HASH}" if optional else "")
        pattern = "[0-9a-f]{64}" + (f"|{NO_HASH}" if optional else "")
        value = self._get(key, allowed)
        if not isinstance(value, str) or not re.fullmatch(pattern, value):
            raise self.refusal(key, repr(value), allowed, "Quote it, so that it stays text")
        return value

    def date(self, key: str = "date") -> str:
        """A day such as 2026-11-23."""
        allowed = 'day of the measurement, "2026-11-23"'
        value = str(self._get(key, allowed))
        try:
            good = datetime.date.fromisoformat(value).isoformat() == value
        except ValueError:
            good = False
        if not good:
            raise self.refusal(key, repr(value), allowed)
        return value

    def evidence(self, least: int, largest_residual: float, unit: str) -> Evidence:
        """The keys of :class:`Evidence`: least number n, bound and unit of the residual."""
        return Evidence(
            covariance=self.covariance(),
            residual=self.number("residual", 0.0, largest_residual, unit),
            n=self.count("n", least),
            condition=self.number("condition", 1.0, 1e6, ""),
            date=self.date(),
            source=self.choice("source", SOURCES),
        )

    def finish(self) -> None:
        """Refuse the first key that nobody asked for.

        Raises:
            ConfigError: There is one.
        """
        if unknown := sorted(set(self._values) - self._known):
            raise self.refusal(unknown[0], "is not a known key", ", ".join(sorted(self._known)))
