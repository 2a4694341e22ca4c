"""Every hand-written mutant of a Python package is noticed. Opt-in: `./surg test --tier mutants`.

Each runs in a copy of the package: the package's unit tests run on it until the first that fails.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from mutants import (
    console_mutants,
    drive_mutants,
    hardware_mutants,
    perception_mutants,
    picture_mutants,
)
from mutants.mutants import Mutant, applied
from mutants.package_tests import killer
from surg_cli.host import paths

pytestmark = pytest.mark.mutants
SOURCES = {"surg_core": "python"}
"""Folder of a package's sources, where it is not `src`."""
FOLDERS = {
    "surg_core": ("pictures", "perception"),
    "surg_hardware": ("hardware", "emulators"),
    "surg_emulators": ("emulators", "hardware"),
    "surg_perception": ("perception", "collecting", "depth"),
    "surg_console": ("console",),
}
"""Folders of `tests/unit` with the tests of a package."""
CHOSEN = {
    "surg_hardware": hardware_mutants.MUTANTS + drive_mutants.MUTANTS,
    "surg_emulators": hardware_mutants.EMULATED + drive_mutants.EMULATED,
    "surg_perception": perception_mutants.MUTANTS,
    "surg_core": picture_mutants.MUTANTS,
    "surg_console": console_mutants.MUTANTS,
}
MUTANTS = [(package, mutant) for package, chosen in CHOSEN.items() for mutant in chosen]


def files_of(package: str) -> list[Path]:
    folders = (paths.ROOT / "tests" / "unit" / name for name in FOLDERS[package])
    return sorted(file for folder in folders for file in folder.glob("test_*.py"))


@pytest.fixture(scope="module")
def copies(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Folder with the copy of each package."""
    made = {}
    for package in FOLDERS:
        made[package] = tmp_path_factory.mktemp(package) / "src"
        sources = paths.ROOT / "src" / package / SOURCES.get(package, "src")
        shutil.copytree(sources, made[package], ignore=shutil.ignore_patterns("__pycache__"))
    return made


@pytest.mark.parametrize("package", FOLDERS)
def test_without_a_mutant_nothing_fails(package: str, copies: dict[str, Path]) -> None:
    assert killer(copies[package], files_of(package), ()) is None


@pytest.mark.parametrize(
    ("package", "mutant"), MUTANTS, ids=[f"{package}-{each.name}" for package, each in MUTANTS]
)
def test_the_mutant_is_noticed(package: str, mutant: Mutant, copies: dict[str, Path]) -> None:
    with applied(mutant, copies[package] / package):
        noticed = killer(copies[package], files_of(package), mutant.first)
    assert noticed is not None, f"nobody notices {mutant.name}: {mutant.why}"
    print(f"{mutant.name}: {noticed}")
