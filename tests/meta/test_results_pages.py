"""Pages of results are short, and their rows are found anew one by one, or all in one run."""

from __future__ import annotations

from pathlib import Path

import pytest

from helpers.results.results_page import FOLDER, ResultsPage

WORDS = 12_000
HEAD = "# A page\n\n| what | n | found |\n|---|---|---|\n"


def test_the_pages_are_short() -> None:
    assert sum(len(page.read_text("utf-8").split()) for page in FOLDER.glob("*.md")) <= WORDS


@pytest.mark.parametrize("whole", [False, True])
def test_rows_that_stand_stay_until_they_are_found_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: bool
) -> None:
    monkeypatch.setenv("SURG_RESULTS_DIR", str(tmp_path))
    file = tmp_path / "page.md"
    old, first, second = (
        "| a | 1 | old |\n| b | – | – |\n",
        "| a | 1 | old |\n",
        "| b | 2 | new |\n",
    )
    file.write_text(HEAD + old)
    page = ResultsPage("page.md", whole)
    page.note("b", None, "2 | new")
    assert file.read_text("utf-8") == HEAD + (old if whole else first + second)
    with pytest.raises(KeyError):
        page.note("c", 1, "of nothing")
    page.note("a", 3, "new")
    assert file.read_text("utf-8") == HEAD + "| a | 3 | new |\n" + second
