"""The documentation has one door: every page is in the index, and the first pages stay short."""

import re

from surg_cli.host import paths

DOCS = paths.ROOT / "docs"
README_LINES = 120
ARCHITECTURE_WORDS = 1500


def test_the_index_lists_every_page_once() -> None:
    text = (DOCS / "README.md").read_text("utf-8")
    listed = sorted(re.findall(r"\]\((?!\.\./)([\w/]+\.md)\)", text))
    pages = (page.relative_to(DOCS) for page in DOCS.rglob("*.md"))
    assert listed == sorted(str(page) for page in pages if str(page) != "README.md")


def test_the_first_pages_stay_short() -> None:
    assert len((paths.ROOT / "README.md").read_text("utf-8").splitlines()) <= README_LINES
    words = (DOCS / "architecture.md").read_text("utf-8").split()
    assert len(words) <= ARCHITECTURE_WORDS


def test_the_files_of_the_control_cycle_exist() -> None:
    text = (DOCS / "architecture.md").read_text("utf-8")
    table = text.split("## One control cycle")[1].split("`operating_state`")[0]
    rows = [line.split("|")[2] for line in table.splitlines() if line.startswith("| ")]
    named = {name for row in rows for name in re.findall(r"`(\w+)`", row)}
    there = {file.stem for file in (paths.ROOT / "src/surg_core/src").rglob("*.cpp")}
    assert len(named) > 20
    assert named - there == set()
