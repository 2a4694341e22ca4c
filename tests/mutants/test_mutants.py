"""Every hand-written mutant of the core is noticed by a test. Opt-in: `./surg test --tier mutants`.

Each runs in a copy of `src/surg_core`. The test that noticed it last runs first, so each
mutant takes some seconds. With `--full` it is kept who noticed what.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from time import monotonic

import pytest

from mutants import core_page
from mutants.core_workshop import Noticed, Workshop
from mutants.mutants import MUTANTS, Mutant
from surg_cli.host import paths

pytestmark = pytest.mark.mutants


@pytest.fixture(scope="module")
def killers() -> Iterator[dict[str, Noticed]]:
    """Who noticed which mutant; becomes the page, with SURG_RESULTS_DIR."""
    found: dict[str, Noticed] = {}
    yield found
    folder = os.environ.get("SURG_RESULTS_DIR")
    if folder and found:
        core_page.write(Path(folder, "mutants.md"), found)


@pytest.fixture(scope="module")
def workshop() -> Workshop:
    root = paths.STATE / "mutants"
    known = core_page.trials_of(core_page.read())
    shop = Workshop(root / "surg_core", root / "build", known)
    shop.set_up(paths.ROOT / "src" / "surg_core")
    return shop


def test_no_mutant_stands_twice() -> None:
    assert len({mutant.name for mutant in MUTANTS}) == len(MUTANTS)
    assert len({mutant.edits for mutant in MUTANTS}) == len(MUTANTS)


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_the_mutant_is_noticed(
    workshop: Workshop, killers: dict[str, Noticed], mutant: Mutant
) -> None:
    started = monotonic()
    noticed = workshop.noticed(mutant)
    assert noticed is not None, f"nobody notices {mutant.name}: {mutant.why}"
    killers[mutant.name] = noticed
    print(f"{mutant.name}: {noticed} ({monotonic() - started:.0f} s)")
