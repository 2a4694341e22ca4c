"""`./surg test`: the C++ tests, then pytest."""

from __future__ import annotations

import argparse

from surg_cli.host import cpp_tests, environment, paths, pytest_workers
from surg_cli.host.terminal import say

TIERS = ("oracle", "vm", "mutants")


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    parser.add_argument(
        "--full", action="store_true", help="long counts (SURG_TEST_FULL=1); rewrites docs/results"
    )
    parser.add_argument("--tier", choices=TIERS, help="run only the tests of one extra tier")
    parser.add_argument(
        "pytest", nargs="*", metavar="PATH", help="pytest arguments; put options behind --"
    )


def main(options: argparse.Namespace, command: str) -> int:
    """Run the tests and print their counts."""
    env = environment.for_nodes()
    env["PYTHONPATH"] = f"{paths.ROOT / 'tools'}:{env.get('PYTHONPATH', '')}".rstrip(":")
    if options.full:
        env["SURG_TEST_FULL"] = "1"
        env["SURG_RESULTS_DIR"] = str(paths.ROOT / "docs" / "results")
    whole = not options.pytest and options.tier is None
    cpp_passed, cpp_failed = cpp_tests.run(env) if whole else (0, 0)
    argv = [str(paths.VENV_PYTHON), "-m", "pytest"]
    argv += options.pytest or [str(paths.ROOT / "tests")]
    if options.tier is not None:
        argv += ["-m", options.tier]
    # Long counts measure times too: nothing may run beside them.
    shared = whole and not options.full
    status, counts = pytest_workers.run(argv, env, shared)
    passed = cpp_passed + counts["passed"]
    failed = cpp_failed + counts["failed"] + counts["errors"] + counts["error"]
    if status != 0 and failed == 0:
        failed = 1  # pytest could not even collect
    say(f"C++ tests: {cpp_passed} passed, {cpp_failed} failed; with pytest:")
    if missing := counts["missing"]:
        say(f"{missing} could not run: what is missing, and how to get it, is said above")
    say(f"{passed} passed, {failed} failed")
    return 0 if failed == 0 and not missing else 1
