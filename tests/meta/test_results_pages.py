"""Pages of results are short, and say what their writers would write above the same rows."""

from __future__ import annotations

import importlib
import pkgutil
from pathlib import Path

import pytest

from helpers import results
from helpers.results.results_page import ResultsPage
from surg_cli.host import paths

FOLDER = paths.ROOT / "docs" / "results"
WORDS = 12_000


def pages() -> dict[str, ResultsPage]:
    """Every page of the helpers by its name."""
    found = {}
    for info in pkgutil.iter_modules(results.__path__):
        module = importlib.import_module(f"{results.__name__}.{info.name}")
        for value in vars(module).values():
            page = getattr(value, "__self__", value)
            if isinstance(page, ResultsPage):
                found[page.name] = page
    return found


def test_the_pages_are_short() -> None:
    assert sum(len(page.read_text("utf-8").split()) for page in FOLDER.glob("*.md")) <= WORDS


@pytest.mark.parametrize("page", pages().values(), ids=pages())
def test_a_page_is_what_its_writer_writes(page: ResultsPage) -> None:
    text = (FOLDER / page.name).read_text("utf-8")
    assert text.startswith(page.head), page.head
    rows = [line.split(" | ")[0].removeprefix("| ") for line in text[len(page.head) :].splitlines()]
    assert rows == [row for row in page.rows if row in rows], "unknown, or out of order"


def test_rows_that_stand_stay_until_they_are_found_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SURG_RESULTS_DIR", str(tmp_path))
    ResultsPage("kept.md", "# Old\n", ("a", "b"), keep=True).note("a", 1, "old")
    page = ResultsPage("kept.md", "# New\n", ("a", "b"), keep=True, columns=("what", "n", "found"))
    page.note("b", None, "2 | new")
    text = (tmp_path / "kept.md").read_text("utf-8")
    assert (
        text == "# New\n\n| what | n | found |\n|---|---|---|\n| a | 1 | old |\n| b | 2 | new |\n"
    )
    with pytest.raises(KeyError):
        page.note("c", 1, "of nothing")
    whole = ResultsPage("whole.md", "# Whole\n", ("a", "b"))
    whole.note("a", 1, "alone")
    assert not (tmp_path / "whole.md").exists()
