"""`./surg test`: the C++ tests, then pytest."""

from __future__ import annotations

import argparse
from collections import Counter

from surg_cli.host import cpp_tests, environment, paths, pytest_run
from surg_cli.host.terminal import say

TIERS = ("oracle", "vm", "mutants")
NO_TESTS = 5
"""pytest's exit status for a run without tests."""


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    add = parser.add_argument
    add("--full", action="store_true", help="long counts (SURG_TEST_FULL=1); writes docs/results")
    add("--tier", choices=TIERS, help="run only the tests of one extra tier")
    add("pytest", nargs="*", metavar="PATH", help="pytest arguments; put options behind --")


def main(options: argparse.Namespace, command: str) -> int:
    """Run the tests and print their counts."""
    env = environment.for_nodes()
    env["PYTHONPATH"] = f"{paths.ROOT / 'tools'}:{env.get('PYTHONPATH', '')}".rstrip(":")
    if options.full:
        env["SURG_TEST_FULL"] = "1"
        env["SURG_RESULTS_DIR"] = str(paths.ROOT / "docs" / "results")
    whole = not options.pytest and options.tier is None
    argv = [str(paths.VENV_PYTHON), "-m", "pytest"]
    cpp = cpp_tests.run(env) if whole else (0, 0)
    tests = options.pytest or [str(paths.ROOT / "tests")]
    argv += ["-m", options.tier] if options.tier else []
    # Long counts also measure times: nothing may run beside them.
    status, counts = pytest_run.run(argv, tests, env, parallel=whole and not options.full)
    if whole and not counts["passed"]:
        status = status or NO_TESTS  # all skipped: nothing was shown
    return _print_counts(cpp, status, counts)


def _print_counts(cpp: tuple[int, int], status: int, counts: Counter[str]) -> int:
    """Print the closing lines; the exit status of the command."""
    passed = cpp[0] + counts["passed"]
    failed = cpp[1] + counts["failed"] + counts["errors"] + counts["error"]
    if status != 0 and failed == 0:
        failed = 1  # pytest could not even collect
    say(f"C++ tests: {cpp[0]} passed, {cpp[1]} failed; with pytest:")
    if missing := counts["missing"]:
        say(f"{missing} could not run; the reasons above say what is missing and how to install it")
    say(f"{passed} passed, {failed} failed")
    return 0 if failed == 0 and not missing else 1
