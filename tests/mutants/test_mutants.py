"""Every hand-written mutant of the core is noticed by a test. Opt-in: `./surg test --tier mutants`.

Each runs in a copy of `src/surg_core`: the changed files are compiled, the library linked, and
the test programs run until the first that fails. With `--full` the table of who noticed what is
written.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic

import pytest

from mutants.mutants import MUTANTS, Mutant, applied
from surg_cli.host import environment, paths, workspace

pytestmark = pytest.mark.mutants

# A broken controller may hang a test that waits for it.
TIMEOUT = 300.0


def plain() -> dict[str, str]:
    """Environment of the programs: reduced counts, no tables, no library but the copy's."""
    env = {name: value for name, value in environment.clean().items() if "SURG_" not in name}
    env.pop("LD_LIBRARY_PATH", None)
    return env


@dataclass
class Workshop:
    """A copy of the core that builds and runs its tests.

    Attributes:
        source: The copy.
        build: Its build folder.
        killers: Which test noticed which mutant, in order.
    """

    source: Path
    build: Path
    killers: list[tuple[Mutant, str, float]] = field(default_factory=list)

    def make(self) -> None:
        """Compile what has changed; a failure is an error with the compiler's words."""
        argv = ["cmake", "--build", str(self.build), f"-j{workspace.jobs()}"]
        done = subprocess.run(argv, capture_output=True, text=True, env=plain())
        assert done.returncode == 0, (done.stdout + done.stderr)[-4000:]

    def programs(self) -> list[str]:
        """Every test program, the fuzz first: it sees most."""
        names = sorted(path.stem for path in (self.source / "tests").rglob("test_*.cpp"))
        return ["fuzz_controller", *names]

    def killer(self, first: tuple[str, ...]) -> str | None:
        """Run the programs until one fails; what failed, or None."""
        order = [*first, *(name for name in self.programs() if name not in first)]
        for name in order:
            argv = [str(self.build / name)]
            if name.startswith("test_"):
                argv.append("--gtest_fail_fast")
            try:
                done = subprocess.run(
                    argv,
                    capture_output=True,
                    text=True,
                    errors="replace",
                    timeout=TIMEOUT,
                    env=plain(),
                )
            except subprocess.TimeoutExpired:
                return f"{name}: does not end"
            if done.returncode == 0:
                continue
            found = re.search(r"\[  FAILED  \] (\S+)", done.stdout) or re.search(
                r"FAILED ([a-z ]+)", done.stdout
            )
            return f"{name}: {found.group(1) if found else f'status {done.returncode}'}"
        return None


@pytest.fixture(scope="module")
def workshop() -> Iterator[Workshop]:
    root = paths.STATE / "mutants"
    shop = Workshop(root / "surg_core", root / "build")
    shop.build.mkdir(parents=True, exist_ok=True)
    refresh(paths.ROOT / "src" / "surg_core", shop.source)
    # Sanitizers are not needed to see a mutant, and -O1 compiles twice as fast.
    flags = ["-DCMAKE_BUILD_TYPE=None", "-DCMAKE_CXX_FLAGS=-O1", "-DBUILD_TESTING=ON"]
    argv = ["cmake", "-S", str(shop.source), "-B", str(shop.build), *flags]
    subprocess.run(argv, check=True, capture_output=True, env=plain())
    shop.make()
    alive = shop.killer(())
    assert alive is None, f"the core fails without any mutant: {alive}"
    yield shop
    write_table(shop.killers)


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


def write_table(killers: list[tuple[Mutant, str, float]]) -> None:
    """docs/results/mutants.md, with SURG_RESULTS_DIR; a run of a part names the part."""
    folder = os.environ.get("SURG_RESULTS_DIR")
    if not folder or not killers:
        return
    run = {mutant.name for mutant, _, _ in killers}
    missing = [f"`{mutant.name}`" for mutant in MUTANTS if mutant.name not in run]
    lines = [
        "# Mutants of the core, and who notices",
        "",
        "Written by `./surg test --full --tier mutants` (`tests/mutants`). Each mutant is a fault",
        "put into a copy of the core on purpose; the test named is the first that failed.",
        "",
        f"{len(MUTANTS)} mutants, {len(killers)} of them run, all of these noticed.",
        *([f"Not run: {', '.join(missing)}."] if missing else []),
        "",
        "| mutant | where | what it would do | noticed by |",
        "|---|---|---|---|",
    ]
    for mutant, killer, _ in killers:
        where = ", ".join(sorted({Path(edit.file).name for edit in mutant.edits}))
        lines.append(f"| `{mutant.name}` | {where} | {mutant.why} | {killer} |")
    path = Path(folder) / "mutants.md"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")


def test_no_mutant_stands_twice() -> None:
    assert len({mutant.name for mutant in MUTANTS}) == len(MUTANTS)
    assert len({mutant.edits for mutant in MUTANTS}) == len(MUTANTS)


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_the_mutant_is_noticed(workshop: Workshop, mutant: Mutant) -> None:
    started = monotonic()
    with applied(mutant, workshop.source):
        workshop.make()
        killer = workshop.killer(mutant.first)
    assert killer is not None, f"nobody notices {mutant.name}: {mutant.why}"
    workshop.killers.append((mutant, killer, monotonic() - started))
    print(f"{mutant.name}: {killer} ({monotonic() - started:.0f} s)")
