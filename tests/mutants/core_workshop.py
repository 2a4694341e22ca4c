"""A copy of the core that is built with a fault in it, and the tests that look for the fault.

Only what a mutant needs is made anew: the files that it changes, the library, and the test program
that is about to run. Programs keep running with another library, so they are not linked again.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

from mutants.mutants import Mutant, applied
from surg_cli.host import environment, workspace

TIMEOUT = 300.0
"""A broken controller may hang a test that waits for it [s]."""


@dataclass(frozen=True)
class Trial:
    """One start of a test program.

    Attributes:
        program: Its name.
        only: The one test of it that runs; empty for all.
    """

    program: str
    only: str = ""

    def argv(self, folder: Path) -> list[str]:
        """The command line."""
        words = [str(folder / self.program)]
        if self.program.startswith("test_"):
            words.append("--gtest_fail_fast")
        if self.only:
            words.append(f"--gtest_filter={self.only}")
        return words


@dataclass(frozen=True)
class Noticed:
    """A trial that failed, and with which words."""

    trial: Trial
    what: str

    def __str__(self) -> str:
        return f"{self.trial.program}: {self.what}"


@dataclass
class Workshop:
    """Builds and runs a copy of the core.

    Attributes:
        source: The copy.
        build: Its build folder.
        known: Who noticed a mutant when it ran last, by the mutant's name.
    """

    source: Path
    build: Path
    known: dict[str, Trial] = field(default_factory=dict)
    _sound: set[Trial] = field(default_factory=set)

    def set_up(self, original: Path) -> None:
        """Copy the core and configure its build."""
        self.build.mkdir(parents=True, exist_ok=True)
        refresh(original, self.source)
        # Sanitizers are not needed to see a mutant. -O0 compiles Eigen no faster than -O1.
        flags = ["-DCMAKE_BUILD_TYPE=None", "-DCMAKE_CXX_FLAGS=-O1", "-DBUILD_TESTING=ON"]
        flags.append("-DCMAKE_LINK_DEPENDS_NO_SHARED=ON")
        if shutil.which("ccache"):  # taking a mutant out again costs no compilation
            flags.append("-DCMAKE_CXX_COMPILER_LAUNCHER=ccache")
        argv = ["cmake", "-S", str(self.source), "-B", str(self.build), *flags]
        subprocess.run(argv, check=True, capture_output=True, env=plain())

    def make(self, program: str) -> None:
        """Build the library and a program; a failure is an error with the compiler's words."""
        argv = ["cmake", "--build", str(self.build), f"-j{workspace.jobs()}", "--target"]
        done = subprocess.run(
            [*argv, "surg_core", program], capture_output=True, text=True, env=plain()
        )
        assert done.returncode == 0, (done.stdout + done.stderr)[-4000:]

    def noticed(self, mutant: Mutant) -> Noticed | None:
        """The first trial that fails with the mutant, and passes without it; None if none does."""
        with applied(mutant, self.source):
            for trial in self.trials(mutant):
                if failure := self.failure(trial):
                    break
            else:
                return None
        if trial not in self._sound:
            without = self.failure(trial)
            assert without is None, f"{trial.program} fails without any mutant: {without}"
            self._sound.add(trial)
        return Noticed(trial, failure)

    def trials(self, mutant: Mutant) -> list[Trial]:
        """Who noticed it last, who is said to, the fuzz, which sees most, and all others."""
        known = self.known.get(mutant.name)
        all_tests = sorted(path.stem for path in (self.source / "tests").rglob("test_*.cpp"))
        ordered = [known.program] if known else []
        ordered += [*mutant.first, "fuzz_controller", *all_tests]
        named = [known] if known and known.only else []
        return [*named, *(Trial(program) for program in dict.fromkeys(ordered))]

    def failure(self, trial: Trial) -> str | None:
        """Build and run; the words of the failure, or None."""
        self.make(trial.program)
        try:
            done = subprocess.run(
                trial.argv(self.build),
                capture_output=True,
                text=True,
                errors="replace",
                timeout=TIMEOUT,
                env=plain(),
            )
        except subprocess.TimeoutExpired:
            return "does not end"
        if trial.only and "[==========] 1 test " not in done.stdout:
            return None  # that test is gone: the others decide
        if done.returncode == 0:
            return None
        found = re.search(r"\[  FAILED  \] (\S+)", done.stdout)
        found = found or re.search(r"FAILED ([a-z ]+)", done.stdout)
        return found.group(1) if found else f"status {done.returncode}"


def plain() -> dict[str, str]:
    """Environment of the programs: reduced counts, no tables, no library but the copy's."""
    env = {name: value for name, value in environment.clean().items() if "SURG_" not in name}
    env.pop("LD_LIBRARY_PATH", None)
    return env


def refresh(original: Path, copy: Path) -> None:
    """Make a copy equal to a tree; files that are equal keep their time, so nothing is rebuilt."""
    wanted = {path.relative_to(original) for path in original.rglob("*") if path.is_file()}
    wanted = {path for path in wanted if not {"build", "__pycache__"} & set(path.parts)}
    for path in list(copy.rglob("*")):
        if path.is_file() and path.relative_to(copy) not in wanted:
            path.unlink()
    for path in wanted:
        target = copy / path
        target.parent.mkdir(parents=True, exist_ok=True)
        if not target.exists() or target.read_bytes() != (original / path).read_bytes():
            shutil.copyfile(original / path, target)
