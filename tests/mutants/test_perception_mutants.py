"""Every hand-written mutant of surg_perception is noticed. Opt-in: `./surg test --tier mutants`.

Each runs in a copy of the package: the tests of `tests/unit/perception` run on it until the first
that fails.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from mutants.mutants import Mutant, applied
from mutants.package_tests import killer
from mutants.perception_mutants import MUTANTS
from surg_cli.host import paths

pytestmark = pytest.mark.mutants
SOURCES = paths.ROOT / "src" / "surg_perception" / "src"
TESTS = sorted((paths.ROOT / "tests" / "unit" / "perception").glob("test_*.py"))


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    made = tmp_path_factory.mktemp("perception") / "src"
    shutil.copytree(SOURCES, made, ignore=shutil.ignore_patterns("__pycache__"))
    yield made


def test_without_a_mutant_nothing_fails(copy: Path) -> None:
    assert killer(copy, TESTS, ()) is None


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_the_perception_mutant_is_noticed(copy: Path, mutant: Mutant) -> None:
    with applied(mutant, copy / "surg_perception"):
        noticed = killer(copy, TESTS, mutant.first)
    assert noticed is not None, f"nobody notices {mutant.name}: {mutant.why}"
    print(f"{mutant.name}: {noticed}")
