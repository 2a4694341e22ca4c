"""Every mutant of the watch for drift is noticed. Opt-in: `./surg test --tier mutants`.

Each runs in a copy of its package, with the tests that it names only.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from mutants.drift_mutants import MUTANTS
from mutants.mutants import Edit, Mutant, applied
from mutants.package_tests import killer
from surg_cli.host import paths

pytestmark = pytest.mark.mutants


def files_of(mutant: Mutant) -> list[Path]:
    return [file for name in mutant.first for file in (paths.ROOT / "tests").rglob(f"{name}.py")]


def test_without_a_mutant_nothing_fails() -> None:
    files = {file for mutant in MUTANTS for file in files_of(mutant)}
    assert killer(paths.ROOT, sorted(files), ()) is None


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_the_mutant_is_noticed(mutant: Mutant, tmp_path: Path) -> None:
    (edit,) = mutant.edits
    package, kind, file = edit.file.split("/", 2)
    shutil.copytree(paths.ROOT / "src" / package / kind, tmp_path / "copy")
    moved = Mutant(mutant.name, mutant.why, (Edit(file, edit.text, edit.instead),), mutant.first)
    with applied(moved, tmp_path / "copy"):
        noticed = killer(tmp_path / "copy", files_of(mutant), mutant.first)
    assert noticed is not None, f"nobody notices {mutant.name}: {mutant.why}"
    print(f"{mutant.name}: {noticed}")
