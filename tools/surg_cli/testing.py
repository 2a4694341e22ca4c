"""`./surg test`: the C++ tests of the core, then pytest."""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
from pathlib import Path

from surg_cli import environment, paths, workspace
from surg_cli.terminal import Problem, Progress, say, warn

CORE_BUILD = paths.STATE / "core_tests"
RACE_BUILD = paths.STATE / "race_tests"
SANITIZED_BUILD = paths.STATE / "core_sanitized"
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
    cpp_passed, cpp_failed = core_tests(env) if whole else (0, 0)
    argv = [str(paths.VENV_PYTHON), "-m", "pytest"]
    argv += options.pytest or [str(paths.ROOT / "tests")]
    if options.tier is not None:
        argv += ["-m", options.tier]
    status, counts = run_pytest(argv, env)
    passed = cpp_passed + counts.get("passed", 0)
    failed = cpp_failed + counts.get("failed", 0) + counts.get("errors", counts.get("error", 0))
    if status != 0 and failed == 0:
        failed = 1  # pytest could not even collect
    say(f"C++ tests: {cpp_passed} passed, {cpp_failed} failed; with pytest:")
    if missing := counts.get("missing", 0):
        say(f"{missing} could not run: what is missing, and how to get it, is said above")
    say(f"{passed} passed, {failed} failed")
    return 0 if failed == 0 and not missing else 1


def core_tests(env: dict[str, str]) -> tuple[int, int]:
    """Build surg_core by CMake alone, as on a machine without ROS, and run its tests.

    Args:
        env: The nodes' environment; SURG_TEST_FULL in it raises the counts, SURG_RESULTS_DIR
            takes the tables of measured figures.

    Returns:
        Numbers of passed and failed tests.

    Raises:
        Problem: When it does not build.
    """
    source = paths.ROOT / "src" / "surg_core"
    if not (source / "CMakeLists.txt").exists():
        warn("surg: src/surg_core has no CMakeLists.txt: no C++ tests")
        return 0, 0
    plain = environment.clean()
    plain.update({k: v for k, v in env.items() if k.startswith(("SURG_TEST", "SURG_RESULTS"))})
    plain.pop("LD_LIBRARY_PATH", None)  # a sourced workspace would lend its own libsurg_core.so
    cmake("C++ tests: build", source, CORE_BUILD, core_options(), [], plain)
    passed, failed = run_core_tests(plain)
    for name, good in sanitized_tests(plain).items():
        passed, failed = passed + good, failed + (not good)
        if not good:
            warn(f"surg: {name} failed: {paths.STATE / 'logs' / name}.log")
    return passed, failed


def cmake(
    title: str,
    source: Path,
    build: Path,
    options: list[str],
    targets: list[str],
    env: dict[str, str],
) -> None:
    """Configure and build a stand-alone CMake project.

    Args:
        title: Shown while it builds.
        source: Folder with its CMakeLists.txt.
        build: Its build folder, which also names the log.
        options: For the configuration.
        targets: What to build; everything when empty.
        env: The compilers' environment.

    Raises:
        Problem: When it does not build.
    """
    log = paths.STATE / "logs" / f"{build.name}.log"
    log.parent.mkdir(parents=True, exist_ok=True)
    chosen = ["--target", *targets] if targets else []
    with Progress(title), log.open("w") as stream:
        for argv in (
            ["cmake", "-S", str(source), "-B", str(build), *options],
            ["cmake", "--build", str(build), f"-j{workspace.jobs()}", *chosen],
        ):
            done = subprocess.run(argv, env=env, stdout=stream, stderr=subprocess.STDOUT)
            if done.returncode != 0:
                lines = log.read_text(errors="replace").splitlines()
                raise Problem(workspace.failure_text(lines, log))


def sanitized_tests(env: dict[str, str]) -> dict[str, bool]:
    """Run what crosses threads under ThreadSanitizer, and with long counts the fuzz of the core.

    The fuzz goes under AddressSanitizer and UndefinedBehaviorSanitizer; its build alone takes a
    minute or two, so the short run has it without them.

    Args:
        env: Their environment; SURG_TEST_FULL in it asks for the long counts.

    Returns:
        Whether each program was content, by its name.
    """
    race = paths.ROOT / "src" / "surg_control" / "tests" / "race"
    core = [f"-DSURG_CORE_BUILD={CORE_BUILD}"]
    cmake("thread sanitizer: build", race, RACE_BUILD, core, [], env)
    programs = [RACE_BUILD / "race_handover"]
    if "SURG_TEST_FULL" in env:
        options = [*core_options(), "-DSURG_CORE_SANITIZE=address,undefined"]
        source, target = paths.ROOT / "src" / "surg_core", ["fuzz_controller"]
        cmake("address sanitizer: build", source, SANITIZED_BUILD, options, target, env)
        programs.append(SANITIZED_BUILD / "fuzz_controller")
    env = {name: value for name, value in env.items() if name != "SURG_RESULTS_DIR"}
    content = {}
    for program in programs:
        with (paths.STATE / "logs" / f"{program.name}.log").open("w") as stream:
            done = subprocess.run([program], env=env, stdout=stream, stderr=subprocess.STDOUT)
        content[program.name] = done.returncode == 0
    return content


def core_options() -> list[str]:
    """CMake options of a stand-alone build of surg_core with its tests."""
    return [
        "-DCMAKE_BUILD_TYPE=Release",
        "-DBUILD_TESTING=ON",
        f"-DPython3_EXECUTABLE={paths.SYSTEM_PYTHON}",
        f"-DPYTHON_EXECUTABLE={paths.SYSTEM_PYTHON}",
    ]


def run_core_tests(env: dict[str, str]) -> tuple[int, int]:
    """Run every gtest program of the stand-alone build.

    Args:
        env: Their environment.

    Returns:
        Numbers of passed and failed tests.
    """
    listed = subprocess.run(
        ["ctest", "--test-dir", str(CORE_BUILD), "--output-on-failure", "-V"],
        env=env,
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
    )
    text = listed.stdout
    passed = sum(int(n) for n in re.findall(r"\[  PASSED  \] (\d+) test", text))
    failed = sum(int(n) for n in re.findall(r"\[  FAILED  \] (\d+) test", text))
    if passed + failed == 0:  # the programs were registered test by test
        summary = re.search(r"(\d+) tests failed out of (\d+)", text)
        if summary:
            failed = int(summary.group(1))
            passed = int(summary.group(2)) - failed
    if listed.returncode != 0:
        failed = max(failed, 1)
        say(text[-6000:])
    (paths.STATE / "logs" / "core_tests_run.log").write_text(text)
    if passed + failed == 0:
        raise Problem("surg_core has no C++ tests: expected gtest programs under ctest")
    return passed, failed


def run_pytest(argv: list[str], env: dict[str, str]) -> tuple[int, dict[str, int]]:
    """Run pytest with its output shown, and read the counts off its closing line.

    Args:
        argv: The command line.
        env: Its environment.

    Returns:
        Exit status, and counts by word such as `passed`.
    """
    process = subprocess.Popen(
        argv, env=env, cwd=paths.ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    assert process.stdout is not None
    tail = b""
    while chunk := os.read(process.stdout.fileno(), 4096):
        sys.stdout.buffer.write(chunk)
        sys.stdout.flush()
        tail = (tail + chunk)[-4000:]
    status = process.wait()
    return status, parse_counts(tail.decode(errors="replace"))


def parse_counts(tail: str) -> dict[str, int]:
    """Counts in pytest's closing lines.

    Args:
        tail: Its last line is such as `== 3 passed, 1 failed in 0.12s ==`. A test of an extra tier
            whose tool is not there is skipped for a reason that begins with `missing:`.

    Returns:
        Numbers by word, and how many tests are `missing`.
    """
    closing = [line for line in tail.splitlines() if " in " in line]
    found = re.findall(r"(\d+) ([a-z]+)", closing[-1] if closing else "")
    counts = {word: int(number) for number, word in found}
    if missing := re.findall(r"^SKIPPED \[(\d+)\] \S+: missing:", tail, re.MULTILINE):
        counts["missing"] = sum(int(number) for number in missing)
    return counts
