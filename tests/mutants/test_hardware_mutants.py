"""Every hand-written mutant of surg_hardware is noticed. Opt-in: `./surg test --tier mutants`.

Each runs in a copy of the package: the tests of `tests/unit/hardware` and `tests/unit/emulators`
run on it until the first that fails.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from mutants.hardware_mutants import MUTANTS
from mutants.mutants import Mutant, applied
from surg_cli.host import paths

pytestmark = pytest.mark.mutants
SOURCES = paths.ROOT / "src" / "surg_hardware" / "src"
TESTS = {
    file.stem: str(file)
    for folder in ("hardware", "emulators")
    for file in (paths.ROOT / "tests" / "unit" / folder).glob("test_*.py")
}
"""Name of a test file -> its path."""
FIRST, REST = 60.0, 300.0
"""A mutant may hang a test: time for the tests that are named first, and for the others [s]."""


def killer(copy: Path, first: tuple[str, ...]) -> str | None:
    """Run the tests on a copy until one fails; what failed, or None."""
    others = [name for name in sorted(TESTS) if name not in first]
    for batch, timeout in ((list(first), FIRST), (others, REST)):
        if not batch:
            continue
        argv = [str(paths.VENV_PYTHON), "-m", "pytest", "-q", "-x", "-p", "no:xdist"]
        env = {**os.environ, "PYTHONPATH": f"{copy}:{os.environ['PYTHONPATH']}"}
        try:
            done = subprocess.run(
                [*argv, *(TESTS[name] for name in batch)],
                cwd=paths.ROOT,
                capture_output=True,
                text=True,
                timeout=timeout,
                env=env,
            )
        except subprocess.TimeoutExpired:
            return f"{batch[0]}: does not end"
        if done.returncode != 0:
            found = re.search(r"FAILED \S+?(test_\w+\.py::\S+)", done.stdout)
            return found.group(1) if found else done.stdout[-300:]
    return None


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    made = tmp_path_factory.mktemp("hardware") / "src"
    shutil.copytree(SOURCES, made, ignore=shutil.ignore_patterns("__pycache__"))
    yield made


def test_without_a_mutant_nothing_fails(copy: Path) -> None:
    assert killer(copy, ()) is None


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_the_hardware_mutant_is_noticed(copy: Path, mutant: Mutant) -> None:
    with applied(mutant, copy / "surg_hardware"):
        noticed = killer(copy, mutant.first)
    assert noticed is not None, f"nobody notices {mutant.name}: {mutant.why}"
    print(f"{mutant.name}: {noticed}")
