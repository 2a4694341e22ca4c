"""The hand-written mutants still fit the sources: cheap, where running them takes hours."""

from __future__ import annotations

from mutants.mutants import MUTANTS
from surg_cli import paths


def test_every_mutant_finds_its_text_exactly_once() -> None:
    core = paths.ROOT / "src" / "surg_core"
    found = {
        f"{mutant.name}: {edit.file}": (core / edit.file).read_text().count(edit.text)
        for mutant in MUTANTS
        for edit in mutant.edits
        if (core / edit.file).is_file()
    }
    places = sum(len(mutant.edits) for mutant in MUTANTS)
    lost = {
        f"{mutant.name}: {edit.file}"
        for mutant in MUTANTS
        for edit in mutant.edits
        if not (core / edit.file).is_file()
    }
    print(f"{len(MUTANTS)} mutants, {places} places")
    assert not lost, f"no such file: {lost}"
    assert {place: n for place, n in found.items() if n != 1} == {}, "once is needed"
    assert all(edit.text != edit.instead for mutant in MUTANTS for edit in mutant.edits)
