"""docs/reference/safety.md: every requirement is on it, and every test that it names exists."""

import re
from pathlib import Path

from surg_cli.host import paths

PAGE = paths.ROOT / "docs" / "reference" / "safety.md"
REQUIREMENTS = [f"F{n:02}" for n in range(1, 39)]


def sources() -> list[Path]:
    """Files that may hold tests."""
    python = (paths.ROOT / "tests").rglob("test_*.py")
    cpp = (paths.ROOT / "src").glob("*/tests/**/*.cpp")
    return [*python, *cpp]


def names_in(file: Path) -> set[str]:
    """Names of the tests in a file, Python or GoogleTest."""
    text = file.read_text("utf-8")
    if file.suffix == ".py":
        return set(re.findall(r"^(?:async )?def (test_\w+)", text, re.MULTILINE))
    return set(re.findall(r"^TEST(?:_F|_P)?\(\w+,\s*(\w+)\)", text, re.MULTILINE))


def named(text: str) -> list[tuple[str, str]]:
    """Tests that a cell names, with the file in parentheses behind one or more of them."""
    found = []
    for tests, file in re.findall(r"((?:`\w+`(?:, )?)+) \((\w+\.(?:py|cpp))\)", text):
        found += [(test, file) for test in re.findall(r"`(\w+)`", tests)]
    return found


def rows() -> dict[str, str]:
    """Lines of the tables by the ids in their first cell."""
    found: dict[str, str] = {}
    for line in PAGE.read_text("utf-8").splitlines():
        first = line.split("|")[1] if line.startswith("| F") else ""
        for name in re.findall(r"F\d\d", first):
            assert name not in found, f"{name} stands twice in {PAGE.name}"
            found[name] = line
    return found


def test_every_requirement_has_a_row() -> None:
    assert sorted(rows()) == REQUIREMENTS


def test_every_test_that_is_named_exists() -> None:
    files = {file.name: file for file in sources()}
    pairs = named(PAGE.read_text("utf-8"))
    assert len(pairs) > 50
    missing = [
        f"{test} ({file})"
        for test, file in pairs
        if file not in files or test not in names_in(files[file])
    ]
    assert not missing, f"{PAGE.name} names tests that do not exist: {missing}"


def test_every_covered_row_names_a_test() -> None:
    files = {file.name for file in sources()}
    for name, line in rows().items():
        if line.count("|") < 6:  # not there yet
            continue
        whole = set(re.findall(r"\b(\w+\.(?:py|cpp))\b", line))
        assert whole, f"{name} names no test"
        assert whole <= files, f"{name} names {sorted(whole - files)}"
