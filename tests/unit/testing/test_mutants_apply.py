"""The hand-written mutants still fit the sources: cheap, where running them takes hours."""

from __future__ import annotations

import pytest

from mutants import (
    console_mutants,
    drift_mutants,
    drive_mutants,
    hardware_mutants,
    mutants,
    perception_mutants,
    picture_mutants,
)
from mutants.mutants import Mutant
from surg_cli.host import paths


@pytest.mark.parametrize(
    ("folder", "chosen"),
    [
        ("surg_core", mutants.MUTANTS),
        ("surg_hardware/src/surg_hardware", hardware_mutants.MUTANTS),
        ("surg_hardware/src/surg_hardware", drive_mutants.MUTANTS),
        ("surg_emulators/src/surg_emulators", hardware_mutants.EMULATED),
        ("surg_emulators/src/surg_emulators", drive_mutants.EMULATED),
        ("surg_perception/src/surg_perception", perception_mutants.MUTANTS),
        ("surg_core/python/surg_core", picture_mutants.MUTANTS),
        ("surg_console/src/surg_console", console_mutants.MUTANTS),
        ("", drift_mutants.MUTANTS),
    ],
)
def test_every_mutant_finds_its_text_exactly_once(folder: str, chosen: tuple[Mutant, ...]) -> None:
    root = paths.ROOT / "src" / folder
    places = [(mutant.name, edit) for mutant in chosen for edit in mutant.edits]
    wrong = []
    for name, edit in places:
        file = root / edit.file
        times = file.read_text().count(edit.text) if file.is_file() else 0
        if times != 1:
            wrong.append(f"{name}: {edit.file} holds this {times} times, once is needed:")
            wrong.append(edit.text)
        assert edit.text != edit.instead, f"{name} changes nothing"
    print(f"{len(chosen)} mutants, {len(places)} places")
    assert not wrong, "\n".join(wrong)


def test_the_tests_that_mutants_name_are_there() -> None:
    """A missing file would end the run like a test that fails, and count as noticed."""
    python = (
        *hardware_mutants.MUTANTS,
        *hardware_mutants.EMULATED,
        *drive_mutants.MUTANTS,
        *drive_mutants.EMULATED,
        *perception_mutants.MUTANTS,
        *picture_mutants.MUTANTS,
        *console_mutants.MUTANTS,
        *drift_mutants.MUTANTS,
    )
    named = {name for mutant in python for name in mutant.first}
    files = {file.stem for file in (paths.ROOT / "tests").rglob("test_*.py")}
    assert named <= files, named - files
