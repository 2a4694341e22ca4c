"""Prints the tuned constants of the core as a Markdown table: `python3 tools/tuned_constants.py`.

Unit and meaning of a constant are its comment, behind it on its line: ``// [s] until it rests``. A
comment without a unit in brackets belongs to a number without one. The lines of a comment above a
group of constants say what they have in common; the sources show them.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

CORE = Path(__file__).resolve().parents[1] / "src" / "surg_core"
NO_TUNING = {
    *("kInf", "kUnknown", "kHuge", "kRound", "kRounding", "kUnitRounding", "kTurnRounding"),
    *("kResolution", "kParallel", "kSingular", "kNoDirection", "kFreeRoll", "kSingularRows"),
    *("kOnPivot", "kRowsKept", "kPositionGuard", "kDof", "kMaxJoints", "kHistory", "kRates"),
    *("kBlocks", "kBlockSteps", "kBlockEvents", "kPlaces", "kSamples", "kSlots", "kTerms", "kMost"),
    *("kAtOnce", "kExact", "kOnPath", "kTouching", "kSwings", "kFirstOvertone"),
    *("kWallRounding", "kPeriodRounding", "kOnAxis"),
    *("kMaxCommands", "kMaxOtherArms", "kMaxLinkCapsules", "kCapacity", "kJoints", "kUrJoints"),
    *("kNobody", "kAny"),
}
"""Rounding, sizes of arrays, what follows from another constant, marks such as infinity."""
_STATED = re.compile(
    r"^ *(?:static |inline )*constexpr (?:double|int) (k\w+) =\s*([^;]+);"
    r"(?: *//[/<]* ((?:.*)(?:\n {8,}//[/<]* .*)*))?$",
    re.MULTILINE,
)


class Constant(NamedTuple):
    """One constant as its line states it."""

    file: str
    name: str
    value: str
    unit: str  # empty: none
    meaning: str  # empty: its line has no comment


def constants(core: Path = CORE) -> Iterator[Constant]:
    """Every tuned constant in the sources of the core, file by file."""
    for file in sorted([*(core / "src").rglob("*.?pp"), *(core / "include").rglob("*.?pp")]):
        for name, value, comment in _STATED.findall(file.read_text("utf-8")):
            if name not in NO_TUNING:
                yield Constant(file.name, name, " ".join(value.split()), *_read(comment))


def _read(comment: str) -> tuple[str, str]:
    """Unit and meaning of a comment."""
    words = re.sub(r"\s+//[/<]* ", " ", comment).strip()
    stated = re.match(r"\[([^\]]+)\]\s*(.*)", words)
    return (stated[1], stated[2]) if stated else ("", words)


def table() -> str:
    """The constants as Markdown."""
    lines = ["| file | constant | value | unit | meaning |", "|---|---|---|---|---|"]
    for each in constants():
        cells = (f"`{each.file}`", f"`{each.name}`", each.value, each.unit or "–", each.meaning)
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.stdout.write(table() + "\n")
