"""Self-contained HTML pages: ``document`` puts sections into the frame that all reports share.

The markup is in ``templates``. A plain string is escaped wherever it stands; what is markup already
is a ``markupsafe.Markup``. None shows as a dash, a float with four figures.
"""

from __future__ import annotations

import base64
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from surg_recording.reports.figure_style import Drawn
from surg_recording.reports.terms import TERMS


def number(value: Any) -> str:
    """Four figures of a float; a dash for None."""
    if value is None:
        return "–"
    return str(value) if isinstance(value, (int, str)) else f"{value:.4g}"


def _shown(value: Any) -> Any:
    return number(value) if value is None or isinstance(value, float) else value


TEMPLATES = jinja2.Environment(
    loader=jinja2.FileSystemLoader(Path(__file__).with_name("templates")),
    autoescape=True,
    finalize=_shown,
    trim_blocks=True,
    lstrip_blocks=True,
    undefined=jinja2.StrictUndefined,
)
_PARTS = TEMPLATES.get_template("parts.html").module


def document(title: str, sections: Iterable[Markup | str], about: str = "") -> str:
    """The whole page: its title, a line about it, and its sections."""
    return TEMPLATES.get_template("page.html").render(title=title, sections=sections, about=about)


def section(title: str, *content: str, verdict: str | None = None) -> Markup:
    """A section under a heading, where a plain string is a paragraph.

    ``verdict`` ``ok`` or ``bad`` gives it a colour.
    """
    return _part("section", title, content, verdict)


def marked(style: str, words: Any) -> Markup:
    """Words in a style of ``page.css``: ``met``, ``missed``, ``faint``."""
    return Markup("<span class='{}'>{}</span>").format(style, words)


MET, MISSED, SUCCESS = marked("met", "met"), marked("missed", "missed"), marked("met", "success")


def code(words: Any) -> Markup:
    """Words as code."""
    return Markup("<code>{}</code>").format(words)


def folded(title: str, content: Markup) -> Markup:
    """Content that a click on its title shows."""
    return Markup("<details><summary class='small'>{}</summary>{}</details>").format(title, content)


def note(words: str) -> Markup:
    """A paragraph in small print."""
    return _part("note", words)


def bullets(items: Iterable[Any]) -> Markup:
    """A list; nothing if it is empty."""
    return _part("bullets", list(items))


def facts(rows: Iterable[tuple[str, Any]]) -> Markup:
    """A table of names and values."""
    return _part("facts", rows)


def table(
    head: Sequence[str], rows: Iterable[Sequence[Any]], right: Collection[int] = ()
) -> Markup:
    """A table with a header; the columns in ``right`` are right-aligned."""
    return _part("table", head, rows, right)


def definitions(*terms: str) -> Markup:
    """A section that defines ``TERMS`` of the page."""
    return section("Definitions", _part("definitions", {term: TERMS[term] for term in terms}))


def picture(data: bytes, kind: str, name: str, caption: str) -> Markup:
    """A picture with its caption; ``kind`` is png, jpeg or svg+xml, ``name`` what it shows."""
    return _part("picture", _embedded(data, f"image/{kind}"), name, caption)


def grid(pictures: Iterable[Markup], columns: str) -> Markup:
    """Pictures beside each other; ``columns`` is ``two``, fewer on a narrow page, or ``three``."""
    return Markup("<div class='grid {}'>{}</div>").format(columns, Markup().join(pictures))


def figure_section(figure: Drawn) -> Markup:
    """A figure under its question, with its caption."""
    data = figure.path.read_bytes()
    return section(figure.title, picture(data, "png", figure.title, figure.caption))


def film_section(folder: Path, caption: str, name: str = "film.mp4") -> Markup:
    """A film of a report's folder; nothing without one."""
    film = folder / name
    if not film.is_file():
        return Markup()
    player = _part("film", _embedded(film.read_bytes(), "video/mp4"))
    return section("", player, note(caption))


def _embedded(data: bytes, kind: str) -> str:
    """Data as an address that holds them."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def _part(name: str, *values: Any) -> Markup:
    return Markup(getattr(_PARTS, name)(*values))
