"""Folders, file names and functions stay small enough to find one's way."""

from collections import Counter
from pathlib import Path

import pytest

from helpers.tree import function_lengths
from helpers.tree.source_tree import product, tracked
from surg_cli.host import paths

MOST_FILES = 25
MOST_LINES = 60

REPEATED = {
    "__init__.py", "CMakeLists.txt", "package.xml", "setup.py", "pyproject.toml", "py.typed",
    "README.md", "demo.py",
}  # fmt: skip
"""File names that a tool, a habit or a command dictates: `python -m surg_sim.demo`."""
GENERATED = {"docs/results"}
"""Folders of pages that the tests and benchmarks write."""
FLAT = {"src/surg_msgs/msg"}
"""Folders that a tool wants flat: `rosmsg` finds no message in a folder below `msg`."""
CPP = {".cpp", ".hpp", ".h"}


def name(file: Path) -> str:
    return str(file.relative_to(paths.ROOT))


def crowded(files: list[Path]) -> dict[str, int]:
    """Folders with too many files, and how many."""
    counts = Counter(str(Path(name(file)).parent) for file in files)
    return {folder: n for folder, n in counts.items() if n > MOST_FILES}


def repeated(files: list[Path]) -> list[str]:
    """Names that several files have; scripts are named after nodes, links after arms."""
    names = [file.name for file in files if file.parent.name not in ("scripts", "links")]
    return [each for each, n in Counter(names).items() if n > 1 and each not in REPEATED]


def long_functions(file: Path, source: str) -> list[str]:
    """Functions of a file that are too long, as `file:function`."""
    if file.suffix == ".py":
        functions = function_lengths.in_python(source)
    elif file.suffix in CPP:
        functions = function_lengths.in_cpp(source)
    else:
        return []
    return [f"{name(file)}:{each.name}" for each in functions if each.lines > MOST_LINES]


def test_no_folder_is_crowded() -> None:
    assert set(crowded(tracked())) - GENERATED - FLAT == set()


def test_no_two_product_files_share_a_name() -> None:
    assert set(repeated(product())) == set()


def test_no_function_is_long() -> None:
    files = [file for file in product() if file.suffix in {".py", *CPP}]
    found = {each for file in files for each in long_functions(file, file.read_text("utf-8"))}
    assert found == set()
    assert len(files) > 400


@pytest.mark.parametrize("lines", [MOST_LINES, MOST_LINES + 1])
def test_a_long_function_is_noticed(lines: int) -> None:
    python = "class A:\n    def f(self):\n" + "        x = 1\n" * (lines - 1)
    cpp = (
        "namespace a {\n// int g() {\nA::A(int x)\n    : a_{x}, b_{2} {\n"
        + '  if (x) { return f("}"); }\n' * (lines - 3)
        + "}\nint h() { return 1; }\n}\n"
    )
    root = paths.ROOT / "src"
    expected = int(lines > MOST_LINES)
    assert len(long_functions(root / "a.py", python)) == expected
    assert len(long_functions(root / "a.cpp", cpp)) == expected
    assert [each.name for each in function_lengths.in_cpp(cpp)] == ["A::A", "h"]
