"""Builds the catkin workspace, and only when its sources have changed."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

from surg_cli.host import distribution, logged, paths, preflight
from surg_cli.host.terminal import CliError, Progress, say

STAMP = paths.TREE_STATE / "build.stamp"
BUILT_ON = paths.BUILD / "built-on"
"""Names the system whose compiler and libraries a build folder holds."""
NO_SOURCES = (".pyc", ".swp", "~", "_core.pyi")
"""Ends of names that a build or an editor writes below `src`."""
RUN_IN_PLACE = (".py", ".pyi", ".html", ".js", ".css", ".svg", ".yaml", ".urdf", ".md")
GOOGLETEST = Path("/usr/include/gtest/gtest.h")
FILES_PER_UNIT = 6
GIB_PER_JOB = 1.6  # one Eigen-heavy translation unit of the pybind11 binding at -O3


def source_files() -> Iterator[Path]:
    """Every file a build depends on, in a fixed order."""
    yield paths.ROOT / "CMakeLists.txt"
    for folder, folders, files in os.walk(paths.ROOT / "src"):
        skip = {"__pycache__", "build", ".mypy_cache", ".ruff_cache", ".pytest_cache"}
        folders[:] = sorted(
            name for name in folders if name not in skip and not name.endswith(".egg-info")
        )
        for name in sorted(files):
            if not name.endswith(NO_SOURCES):
                yield Path(folder, name)


def _is_built(path: Path) -> bool:
    """Whether the build reads a file's content. The devel space runs Python where it stands."""
    return path.suffix not in RUN_IN_PLACE or path.name == "setup.py"


def fingerprint() -> str:
    """Digest of what the build reads: names; sizes and times of sources; system, GoogleTest."""
    digest = hashlib.sha256(distribution.here().key.encode())
    for path in source_files():
        try:
            info = path.stat()
        except FileNotFoundError:  # an editor's file that has just gone
            continue
        content = f"|{info.st_size}|{info.st_mtime_ns}" if _is_built(path) else ""
        digest.update(f"{path}{content}\n".encode())
    digest.update(str(paths.VENV_PYTHON.exists()).encode())
    digest.update(str(GOOGLETEST.exists()).encode())  # it came later: the tests need a new pass
    return digest.hexdigest()


def is_current() -> bool:
    """Whether the devel space was built from the sources as they are."""
    return (
        (paths.DEVEL / "setup.bash").exists()
        and STAMP.exists()
        and STAMP.read_text() == fingerprint()
    )


def jobs() -> int:
    """Parallel compilers: one per core, fewer where memory is short."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    return max(1, min(len(os.sched_getaffinity(0)), int(total / GIB_PER_JOB)))


def build(log: Path, force: bool = False) -> bool:
    """Configure and build into `build/` and `devel/`; returns whether anything had to be done.

    Raises:
        CliError: A step fails; the text holds the last lines of its output.
    """
    before = fingerprint()
    if not force and is_current():
        return False
    preflight.check_path()
    preflight.check_tree()
    preflight.check_space(paths.BUILD)
    say(f"build: {paths.BUILD} -> {paths.DEVEL} (log: {log})")
    _forget_other_tree()
    paths.write_text(BUILT_ON, distribution.here().key)
    configure = [_cmake(), "-S", str(paths.ROOT), "-B", str(paths.BUILD)]
    configure += ["-G", "Unix Makefiles", f"-DCATKIN_DEVEL_PREFIX={paths.DEVEL}"]
    configure += _unity()
    compile_ = [_cmake(), "--build", str(paths.BUILD), f"-j{jobs()}"]
    with Progress("build") as progress:
        logged.run(configure, log, progress, anew=True, failure=failure_text)
        logged.run(compile_, log, progress, fraction=make_fraction, failure=failure_text)
    # Sources may have changed meanwhile: the stamp says what was there at the start.
    paths.write_text(STAMP, before)
    return True


def _unity() -> list[str]:
    """Options that compile several files as one: the headers take half of the time.

    Not under a compiler cache, which keeps files that several builds share.
    """
    if os.environ.get("CMAKE_CXX_COMPILER_LAUNCHER"):
        return ["-DCMAKE_UNITY_BUILD=OFF"]
    return ["-DCMAKE_UNITY_BUILD=ON", f"-DCMAKE_UNITY_BUILD_BATCH_SIZE={FILES_PER_UNIT}"]


def _cmake() -> str:
    """Debian's cmake, whatever stands first on the caller's PATH."""
    program = "/usr/bin/cmake"
    if not os.access(program, os.X_OK):
        raise CliError(f"{program} is missing; run ./surg dev setup")
    return program


def _forget_other_tree() -> None:
    """Remove a build folder of another path, which CMake would refuse, or of another system."""
    cache = paths.BUILD / "CMakeCache.txt"
    if not cache.exists():
        return
    text = cache.read_text("utf-8", errors="replace")
    home = re.search(r"^CMAKE_HOME_DIRECTORY:INTERNAL=(.*)$", text, re.MULTILINE)
    python = re.search(r"^PYTHON_EXECUTABLE:[A-Z]*=(.*)$", text, re.MULTILINE)
    wanted = paths.VENV_PYTHON if paths.VENV_PYTHON.exists() else paths.SYSTEM_PYTHON
    moved = home is not None and Path(home.group(1)) != paths.ROOT
    other_python = python is not None and Path(python.group(1)) != wanted
    made_on = BUILT_ON.read_text("utf-8") if BUILT_ON.exists() else distribution.here().key
    if made_on != distribution.here().key:
        say(f"{paths.BUILD} was built on {made_on}, this is {distribution.here().key}: built anew")
    if moved or other_python or made_on != distribution.here().key:
        shutil.rmtree(paths.BUILD)


def make_fraction(lines: Sequence[str]) -> float | None:
    """How far make is: CMake's rules begin their lines with it."""
    done = (re.match(r"\[\s*(\d+)%\]", line) for line in reversed(lines))
    return next((int(match.group(1)) / 100 for match in done if match), None)


def failure_text(lines: Sequence[str], log: Path) -> str:
    """What to show of a failed build: the first errors, else the last lines."""
    errors = [
        i
        for i, line in enumerate(lines)
        if re.search(r"\berror\b[: ]|undefined reference|CMake Error", line)
    ]
    shown = lines[errors[0] : errors[0] + 12] if errors else lines[-15:]
    return "the build failed:\n" + "\n".join(shown) + f"\nThe whole output: {log}"
