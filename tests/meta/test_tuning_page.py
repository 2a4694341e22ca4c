"""docs/reference/tuning.md: every constant of the core stands there with the value that it has."""

import re

from surg_cli.host import paths

CORE = paths.ROOT / "src" / "surg_core"
PAGE = paths.ROOT / "docs" / "reference" / "tuning.md"
# Rounding, sizes of arrays and marks such as infinity: they tune nothing.
ARITHMETIC = {
    *("kInf", "kUnknown", "kHuge", "kRound", "kRounding", "kPositionRounding", "kResolution"),
    *("kParallel", "kSingular", "kStraight", "kAtSingular", "kNoDirection", "kSingularRows"),
    *("kOnPivot", "kRowsKept", "kPositionGuard", "kDof", "kMaxJoints", "kHistory", "kVersion"),
    *("kBlocks", "kBlockEvents", "kPlaces", "kSamples", "kTerms"),
    *("kWallRounding", "kPeriodRounding", "kOnAxis", "kPivotReached"),
}


def constants() -> dict[tuple[str, str], str]:
    """Value as written, by file and name, of every constant in the core's sources."""
    found = {}
    for file in sorted([*(CORE / "src").rglob("*.?pp"), *(CORE / "include").rglob("*.?pp")]):
        text = file.read_text("utf-8")
        for stated in re.findall(r"\bconstexpr (?:double|int) (k\w+ =[^;]+);", text):
            for name, value in re.findall(r"(k\w+) =\s*([^,]+)", stated):
                if name not in ARITHMETIC:
                    found[file.name, name] = value.strip()
    return found


def rows() -> dict[tuple[str, str], str]:
    """The same, as the page states it."""
    row = r"^\| `(\w+\.[ch]pp)` \| `(k\w+)` \| ([^|]+) \|[^|]*\| [^|]{8,} \|$"
    found = re.findall(row, PAGE.read_text("utf-8"), re.MULTILINE)
    return {(file, name): value.strip() for file, name, value in found}


def test_the_page_has_every_constant_with_its_value() -> None:
    stated, real = rows(), constants()
    assert len(real) > 60, "the search for constants finds none any more"
    assert not set(real) - set(stated), "add a row with what it does"
    assert not set(stated) - set(real), "remove the row"
    assert stated == real
