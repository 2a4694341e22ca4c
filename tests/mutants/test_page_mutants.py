"""Every hand-written mutant of the pages is noticed. Opt-in: `./surg test --tier mutants`.

Each runs in a copy of the package: the tests of the pages run on it, in Chromium, until the first
that fails.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from helpers.teleop import chromium
from mutants.mutants import Mutant, applied
from mutants.package_tests import killer
from mutants.page_mutants import CONSOLE, HEADSET, MONITOR, MUTANTS
from surg_cli.host import paths

pytestmark = [
    pytest.mark.mutants,
    pytest.mark.skipif(bool(chromium.missing()), reason=chromium.missing()),
]
TESTS = {name: paths.ROOT / "tests/e2e" / f"{name}.py" for name in MONITOR + HEADSET + CONSOLE}


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder with the copy of the package."""
    made = tmp_path_factory.mktemp("pages") / "src"
    sources = paths.ROOT / "src" / "surg_console" / "src"
    shutil.copytree(sources, made, ignore=shutil.ignore_patterns("__pycache__"))
    return made


@pytest.fixture(autouse=True)
def every_test(monkeypatch: pytest.MonkeyPatch) -> None:
    """The long tests of the pages as well."""
    monkeypatch.setenv("SURG_TEST_FULL", "1")


def test_without_a_mutant_nothing_fails(copy: Path) -> None:
    assert killer(copy, list(TESTS.values()), ()) is None


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_the_mutant_is_noticed(mutant: Mutant, copy: Path) -> None:
    with applied(mutant, copy / "surg_console/web/page"):
        noticed = killer(copy, [TESTS[name] for name in mutant.first], mutant.first)
    assert noticed is not None, f"nobody notices {mutant.name}: {mutant.why}"
    print(f"{mutant.name}: {noticed}")
