"""The hand-written mutants still fit the sources: cheap, where running them takes hours."""

from __future__ import annotations

from mutants.mutants import MUTANTS
from surg_cli.host import paths


def test_every_mutant_finds_its_text_exactly_once() -> None:
    core = paths.ROOT / "src" / "surg_core"
    places = [(mutant.name, edit) for mutant in MUTANTS for edit in mutant.edits]
    wrong = []
    for name, edit in places:
        file = core / edit.file
        times = file.read_text().count(edit.text) if file.is_file() else 0
        if times != 1:
            wrong.append(f"{name}: {edit.file} holds this {times} times, once is needed:")
            wrong.append(edit.text)
        assert edit.text != edit.instead, f"{name} changes nothing"
    print(f"{len(MUTANTS)} mutants, {len(places)} places")
    assert not wrong, "\n".join(wrong)
