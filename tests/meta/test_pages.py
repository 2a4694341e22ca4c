"""Pages: every link leads somewhere, every command line of the guide parses, sentences are short.

`python tests/meta/test_pages.py` prints the mean sentence length of every page.
"""

import contextlib
import io
import re
import sys
from pathlib import Path

import pytest

from helpers.tree import markdown
from helpers.tree.source_tree import tracked
from surg_cli import command_table
from surg_cli.host import paths
from surg_cli.host.terminal import CliError

MOST_WORDS = 17


def pages() -> list[Path]:
    return sorted(file for file in tracked() if file.suffix == ".md")


def guide() -> list[Path]:
    """The pages that a newcomer reads."""
    return [paths.ROOT / "README.md", *sorted((paths.ROOT / "docs" / "guide").rglob("*.md"))]


def name(file: Path) -> str:
    return str(file.relative_to(paths.ROOT))


def mistake(words: list[str]) -> str:
    """Why the command line of `./surg` does not parse, empty if it does."""
    if command_table.page(words):
        return ""
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            command_table.parse(*command_table.find(words))
    except CliError as problem:
        return str(problem)
    except SystemExit as end:
        return said.getvalue() if end.code else ""
    return ""


def test_every_relative_link_leads_somewhere() -> None:
    found = {name(page): markdown.broken_links(page, page.read_text("utf-8")) for page in pages()}
    assert {page: links for page, links in found.items() if links} == {}
    assert len(found) > 50


def test_every_command_line_of_the_guide_parses() -> None:
    lines = [
        (name(page), words) for page in guide() for words in markdown.surg_lines(page.read_text())
    ]
    wrong = [f"{page}: {' '.join(words)}: {mistake(words)}" for page, words in lines]
    assert [text for text in wrong if not text.endswith(": ")] == []
    assert len(lines) > 30


def test_a_command_within_a_sentence_is_none_of_before() -> None:
    """What follows it may be left out; a command or option that has moved may not be named."""
    wrong = []
    for page in pages():
        for command in re.findall(r"`\./surg ([^`|…]+)`", page.read_text("utf-8")):
            said = mistake(command.split())
            if said and not said.startswith("usage:") and page.name != "CHANGELOG.md":
                wrong.append(f"{name(page)}: {command}: {said}")
    assert wrong == []


def test_sentences_of_the_guide_are_short() -> None:
    lengths = {name(page): markdown.mean_sentence_length(page.read_text()) for page in guide()}
    for page, words in lengths.items():
        print(f"{words:5.1f} words per sentence: {page}")
    assert {page for page, words in lengths.items() if words > MOST_WORDS} == set()


@pytest.mark.parametrize(
    ("link", "good"),
    [
        ("[a](other.md)", True),
        ("[a](#on-this-page)", True),
        ("[a](other.md#who-uses-whom-and-why)", True),
        ("[a](https://example.org/nothing)", True),
        ("`[a](code.md)`", True),
        ("[a](nowhere.md)", False),
        ("[a](#nowhere)", False),
        ("[a](other.md#nowhere)", False),
        ('<img src="nowhere.png">', False),
    ],
)
def test_a_broken_link_is_noticed(link: str, good: bool, tmp_path: Path) -> None:
    (tmp_path / "other.md").write_text("# Other\n\n## Who uses `whom`, and why\n")
    text = f"# On this page\n\n{link}\n"
    assert (markdown.broken_links(tmp_path / "page.md", text) == []) is good


if __name__ == "__main__":
    for each in pages():
        print(f"{markdown.mean_sentence_length(each.read_text('utf-8')):5.1f}  {name(each)}")
    sys.exit(0)
