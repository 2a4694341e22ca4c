"""`./surg test --coverage`: which lines the tests run, by package, in Python and C++.

Tracing slows Python down several times, and graphs in real time would fail. So Python is traced in
tests/unit and tests/meta alone; nodes in processes of their own are not counted.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Mapping
from pathlib import Path

from surg_cli.host import cpp_tests, environment, paths
from surg_cli.host.terminal import say, table

FOLDER = paths.STATE / "coverage"
DATA = FOLDER / "python.data"
CORE_BUILD = paths.STATE / "core_coverage"
TESTS = ("tests/unit", "tests/meta")


def python_packages() -> list[Path]:
    """Folders of the Python packages."""
    patterns = ("src/*/src/surg_*", "src/*/python/surg_*", "src/*/client/src/surg_*")
    found = [path for pattern in patterns for path in paths.ROOT.glob(pattern) if path.is_dir()]
    return [*sorted(found), paths.ROOT / "tools" / "surg_cli"]


def pytest_options() -> list[str]:
    """Options that make pytest trace our packages."""
    return [*(f"--cov={path}" for path in python_packages()), "--cov-report="]


def run_core_tests(env: Mapping[str, str]) -> tuple[int, int]:
    """Build surg_core with gcov and run its tests; returns how many passed and failed."""
    plain = {**cpp_tests.plain_environment(env), "LC_ALL": "C"}
    options = [*cpp_tests.core_options(), "-DCMAKE_CXX_FLAGS=--coverage -O1"]
    cpp_tests.cmake("coverage: build", cpp_tests.CORE, CORE_BUILD, options, [], plain)
    for old in CORE_BUILD.rglob("*.gcda"):
        old.unlink()
    return cpp_tests.gtests(["ctest", "--test-dir", str(CORE_BUILD), "-V"], "core_coverage", plain)


def report() -> None:
    """Print the share of lines that were run, by package, and write both HTML reports."""
    rows = [["package", "lines", "run"], *_python_rows(), _cpp_row()]
    say(f"coverage:\n{table(rows)}")
    say(f"  by line: {FOLDER / 'python' / 'index.html'}, {FOLDER / 'cpp.html'}")


def _python_rows() -> list[list[str]]:
    env = {**environment.clean(), "COVERAGE_FILE": str(DATA)}
    summary = FOLDER / "python.json"
    coverage = [str(paths.VENV_PYTHON), "-m", "coverage"]
    for words in (["json", "-q", "-o", str(summary)], ["html", "-q", "-d", str(FOLDER / "python")]):
        subprocess.run([*coverage, *words], env=env, cwd=paths.ROOT, check=True)
    files = json.loads(summary.read_text("utf-8"))["files"]
    rows = []
    for package in python_packages():
        inside = str(package.relative_to(paths.ROOT)) + "/"
        counts = [entry["summary"] for name, entry in files.items() if name.startswith(inside)]
        lines = sum(count["num_statements"] for count in counts)
        rows.append(_row(package.name, lines, sum(count["covered_lines"] for count in counts)))
    return rows


def _cpp_row() -> list[str]:
    summary = FOLDER / "cpp.json"
    argv = ["gcovr", "--root", str(cpp_tests.CORE), str(CORE_BUILD), "--exclude", ".*/tests/.*"]
    argv += ["--json-summary", str(summary), "--html-details", str(FOLDER / "cpp.html")]
    subprocess.run(argv, env=environment.clean(), check=True)
    total = json.loads(summary.read_text("utf-8"))
    return _row("surg_core (C++)", total["line_total"], total["line_covered"])


def _row(name: str, lines: int, covered: int) -> list[str]:
    return [name, str(lines), f"{100 * covered / lines:.0f} %" if lines else "–"]
