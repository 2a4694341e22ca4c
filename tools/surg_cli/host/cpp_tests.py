"""The C++ tests: the core by CMake alone, what crosses threads, the control node."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

from surg_cli.host import environment, logged, paths, workspace
from surg_cli.host.terminal import CliError, Progress, say, warn

CORE = paths.ROOT / "src" / "surg_core"
RACE = paths.ROOT / "src" / "surg_control" / "tests" / "race"
CORE_BUILD = paths.STATE / "core_tests"
RACE_BUILD = paths.STATE / "race_tests"
SANITIZED_BUILD = paths.STATE / "core_sanitized"
CONTROL_TEST = "surg_control_test"
LIBRARY = paths.DEVEL / "lib" / "libsurg_core.so"


def run(env: Mapping[str, str]) -> tuple[int, int]:
    """Build and run all of them; returns how many passed and failed.

    In the nodes' environment SURG_TEST_FULL raises the counts, and SURG_RESULTS_DIR takes the
    tables of measured figures.

    Raises:
        CliError: Something does not build.
    """
    plain = plain_environment(env)
    counts = [core_tests(plain), sanitized_tests(plain), control_tests(env)]
    return sum(passed for passed, _ in counts), sum(failed for _, failed in counts)


def plain_environment(env: Mapping[str, str]) -> dict[str, str]:
    """An environment without the workspace, with the options of the tests."""
    plain = environment.clean()
    plain.update({k: v for k, v in env.items() if k.startswith(("SURG_TEST", "SURG_RESULTS"))})
    plain.pop("LD_LIBRARY_PATH", None)  # a sourced workspace would lend its own libsurg_core.so
    return plain


def core_tests(env: Mapping[str, str]) -> tuple[int, int]:
    """Build the tests of surg_core by CMake alone round the workspace's library, and run them."""
    options = [*core_options(), f"-DSURG_CORE_LIBRARY={LIBRARY}"]
    cmake("C++ tests: build", CORE, CORE_BUILD, options, [], env)
    # Long counts measure times as well: then one program after the other.
    jobs = 1 if "SURG_TEST_FULL" in env else workspace.jobs()
    return gtests(
        ["ctest", "--test-dir", str(CORE_BUILD), "-V", f"-j{jobs}"], "core_tests_run", env
    )


def control_tests(env: Mapping[str, str]) -> tuple[int, int]:
    """Build the control node's tests in the workspace, where its libraries are, and run them."""
    build("control tests: build", CONTROL_TEST, [compilation(paths.BUILD, CONTROL_TEST)], env)
    program = paths.DEVEL / "lib" / "surg_control" / CONTROL_TEST
    return gtests([str(program)], f"{CONTROL_TEST}_run", env)


def sanitized_tests(env: Mapping[str, str]) -> tuple[int, int]:
    """Run what crosses threads under ThreadSanitizer, and with long counts the fuzz of the core.

    The fuzz runs under AddressSanitizer and UndefinedBehaviorSanitizer; its build alone takes a
    minute or two, so the short run has it without them. Returns how many programs passed and
    failed.
    """
    core = [f"-DSURG_CORE_BUILD={LIBRARY.parent}"]
    cmake("thread sanitizer: build", RACE, RACE_BUILD, core, [], env)
    programs = [RACE_BUILD / "race_thread_channels"]
    if "SURG_TEST_FULL" in env:
        options = [*core_options(), "-DSURG_CORE_SANITIZE=address,undefined"]
        cmake("address sanitizer: build", CORE, SANITIZED_BUILD, options, ["fuzz_controller"], env)
        programs.append(SANITIZED_BUILD / "fuzz_controller")
    env = {name: value for name, value in env.items() if name != "SURG_RESULTS_DIR"}
    failed = 0
    for program in programs:
        log = paths.STATE / "logs" / f"{program.name}.log"
        with log.open("w") as stream:
            done = subprocess.run([program], env=env, stdout=stream, stderr=subprocess.STDOUT)
        if done.returncode != 0:
            failed += 1
            warn(f"surg: {program.name} failed: {log}")
    return len(programs) - failed, failed


def core_options() -> list[str]:
    """CMake options of a stand-alone build of surg_core with its tests."""
    return [
        "-DCMAKE_BUILD_TYPE=Release",
        "-DBUILD_TESTING=ON",
        f"-DPython3_EXECUTABLE={paths.SYSTEM_PYTHON}",
        f"-DPYTHON_EXECUTABLE={paths.SYSTEM_PYTHON}",
    ]


def cmake(
    title: str,
    source: Path,
    folder: Path,
    options: Sequence[str],
    targets: Sequence[str],
    env: Mapping[str, str],
) -> None:
    """Configure and build targets (none: all) of a stand-alone CMake project.

    ``folder`` is the build folder, which also names the log.

    Raises:
        CliError: It does not build.
    """
    configuration = ["cmake", "-S", str(source), "-B", str(folder), *options]
    build(title, folder.name, [configuration, compilation(folder, *targets)], env)


def compilation(folder: Path, *targets: str) -> list[str]:
    """The command line that builds targets of a configured folder; without targets, all."""
    chosen = ["--target", *targets] if targets else []
    return ["cmake", "--build", str(folder), f"-j{workspace.jobs()}", *chosen]


def build(title: str, name: str, commands: Sequence[Sequence[str]], env: Mapping[str, str]) -> None:
    """Run the commands of a build, with a log of this name.

    Raises:
        CliError: One of them fails.
    """
    log = paths.STATE / "logs" / f"{name}.log"
    with Progress(title) as progress:
        for i, argv in enumerate(commands):
            logged.run(
                argv,
                log,
                progress,
                anew=i == 0,
                fraction=workspace.make_fraction,
                failure=workspace.failure_text,
                env=env,
            )


def gtests(argv: Sequence[str], name: str, env: Mapping[str, str]) -> tuple[int, int]:
    """Run gtest programs; their output is shown if one fails.

    Returns how many tests passed and failed; a program that ends otherwise than gtest does counts
    as failed.

    Raises:
        CliError: There was no test.
    """
    log = paths.STATE / "logs" / f"{name}.log"
    status = 0
    with Progress(name.replace("_", " ")) as progress:
        try:
            logged.run(argv, log, progress, anew=True, env=env)
        except CliError:
            status = 1
    text = log.read_text(errors="replace")
    passed = sum(int(n) for n in re.findall(r"\[  PASSED  \] (\d+) test", text))
    failed = sum(int(n) for n in re.findall(r"\[  FAILED  \] (\d+) test", text))
    if status != 0:
        failed = max(failed, 1)
        say(text[-6000:])
    if passed + failed == 0:
        raise CliError(f"no C++ tests: {' '.join(argv)} ran none (log: {name}.log)")
    return passed, failed
