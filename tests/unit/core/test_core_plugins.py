"""Plug-ins from outside the tree: every way to name one, and every way to get it wrong."""

from __future__ import annotations

import abc
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from surg_core.plugins import PluginError, PluginKind, source_file


class Knot(abc.ABC):
    """A plug-in of a made-up kind."""

    name: str

    @abc.abstractmethod
    def tie(self) -> str:
        """Ties it."""


KNOTS = PluginKind(
    noun="knot",
    group="test.knots",
    bundled={"reef": "bundled_reef"},
    accepts=lambda kind: issubclass(kind, Knot) and kind is not Knot,
    shape="one class derived from Knot",
    required=("name",),
)
SOURCE = """
from dataclasses import dataclass
from {here} import Knot

@dataclass
class {title}(Knot):
    name = "{name}"
    def tie(self):
        return "{name}"
"""


def source(name: str) -> str:
    return SOURCE.format(here=__name__, title=name.title(), name=name)


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder of installed packages with one bundled and one foreign plug-in."""
    (tmp_path / "bundled_reef.py").write_text(source("reef"))
    (tmp_path / "sailor.py").write_text(source("bowline") + "\nANCHOR = 3\n")
    info = tmp_path / "sailor-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: sailor\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[test.knots]\nbowline = sailor:Bowline\nanchor = sailor:ANCHOR\ngone = nowhere:X\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    before = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - before:
        del sys.modules[name]


@pytest.mark.parametrize("name", ["reef", "bowline", "own.py"])
def test_found_by_name_by_entry_point_and_by_path(installed: Path, name: str) -> None:
    (installed / "own.py").write_text(source("own"))
    asked = str(installed / name) if name.endswith(".py") else name
    knot = KNOTS.find(asked)()
    assert isinstance(knot, Knot)
    assert knot.tie() == name.removesuffix(".py")
    assert source_file(knot) == (asked if name.endswith(".py") else None)


def test_names_are_the_bundled_then_the_installed(installed: Path) -> None:
    assert KNOTS.names() == ("reef", "anchor", "bowline", "gone")


def test_an_unknown_name_lists_what_exists(installed: Path) -> None:
    with pytest.raises(PluginError) as caught:
        KNOTS.find("granny")
    assert caught.value.where == "granny"
    assert all(name in caught.value.cure for name in KNOTS.names())


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "defines 0 knots"),
        (source("one") + source("two"), "defines 2 knots"),
        ("import nothing_of_this_name", "ModuleNotFoundError"),
        ("def", "SyntaxError"),
        (f"from {__name__} import Knot\nclass Half(Knot): pass", "Half lacks name, tie"),
        (None, "no such file"),
    ],
)
def test_a_file_that_holds_none_is_named(tmp_path: Path, text: str | None, what: str) -> None:
    file = tmp_path / "broken.py"
    if text is not None:
        file.write_text(text)
    with pytest.raises(PluginError, match=what) as caught:
        KNOTS.find(str(file))
    assert caught.value.where == str(file)


@pytest.mark.parametrize(("name", "what"), [("anchor", "no knot"), ("gone", "ModuleNotFound")])
def test_an_entry_point_that_names_none_is_refused(installed: Path, name: str, what: str) -> None:
    with pytest.raises(PluginError, match=what):
        KNOTS.find(name)
