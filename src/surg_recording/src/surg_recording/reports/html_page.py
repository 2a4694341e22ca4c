"""Parts of a self-contained HTML page."""

from __future__ import annotations

import base64
import html
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any

from surg_recording.reports.figure_style import Drawn
from surg_recording.reports.terms import TERMS

CSS = """
:root { color-scheme: light; }
body { margin: 0; background: #f3f4f6; color: #1f2933;
       font: 15px/1.5 system-ui, "DejaVu Sans", sans-serif; }
main { max-width: 960px; margin: 0 auto; padding: 24px 16px 64px; }
section { background: #fff; border: 1px solid #e4e7eb; border-radius: 8px; padding: 16px 22px;
          margin: 16px 0; }
h1 { font-size: 24px; margin: 8px 0 2px; } h2 { font-size: 18px; margin: 4px 0 10px; }
.faint { color: #5f6c7b; } .small { font-size: 13px; }
.verdict { border-left: 8px solid; } .ok { border-left-color: #2f8f5b; }
.bad { border-left-color: #c62f3b; }
table { border-collapse: collapse; width: 100%; }
th, td { text-align: left; padding: 4px 12px 4px 0; border-bottom: 1px solid #e4e7eb;
         vertical-align: top; }
th { font-weight: 600; } td.n { font-variant-numeric: tabular-nums; }
td.n, th.n { text-align: right; }
.met { color: #2f8f5b; font-weight: 600; } .missed { color: #c62f3b; font-weight: 600; }
img, video { max-width: 100%; height: auto; display: block; }
.strip { display: grid; grid-template-columns: repeat(3, 1fr); gap: 8px; }
.strip figure { margin: 0; } figcaption { color: #5f6c7b; font-size: 13px; }
dt { font-weight: 600; margin-top: 8px; } dd { margin: 0 0 4px; }
code { font-size: 13px; overflow-wrap: anywhere; }
"""


class Html(str):
    """Markup that is not escaped."""


def document(title: str, sections: Iterable[str]) -> str:
    """The whole page, from the markup of its sections."""
    return (
        "<!DOCTYPE html>\n<html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width, initial-scale=1'>"
        f"<title>{text(title)}</title><style>{CSS}</style></head>\n<body><main>\n"
        + "\n".join(sections)
        + "\n</main></body></html>\n"
    )


def section(title: str, *content: str, verdict: str | None = None) -> str:
    """A section under a heading, from markup; ``verdict`` ``ok`` or ``bad`` gives it a colour."""
    style = "" if verdict is None else f" class='verdict {verdict}'"
    return f"<section{style}><h2>{text(title)}</h2>{''.join(content)}</section>"


def note(words: str) -> str:
    """A paragraph in small print."""
    return f"<p class='faint small'>{text(words)}</p>"


def bullets(items: Iterable[Any], style: str = "") -> str:
    """A list; nothing if it is empty."""
    entries = "".join(f"<li>{cell(item)}</li>" for item in items)
    return f"<ul class='{style}'>{entries}</ul>" if entries else ""


def facts(rows: Iterable[tuple[str, Any]]) -> str:
    """A table of names and values."""
    cells = "".join(f"<tr><th>{text(name)}</th><td>{cell(value)}</td></tr>" for name, value in rows)
    return f"<table>{cells}</table>"


def table(
    head: Sequence[str],
    rows: Iterable[Sequence[Any]],
    right: Collection[int] = (),
    style: str = "small",
) -> str:
    """A table with a header; the columns in ``right`` are right-aligned."""
    alignment = [" class='n'" if column in right else "" for column in range(len(head))]

    def line(tag: str, values: Sequence[Any]) -> str:
        pairs = zip(alignment, values, strict=True)
        return f"<tr>{''.join(f'<{tag}{n}>{cell(value)}</{tag}>' for n, value in pairs)}</tr>"

    body = "".join(line("td", row) for row in rows)
    return f"<table class='{style}'>{line('th', head)}{body}</table>"


def definitions(*terms: str) -> str:
    """A section that defines ``TERMS`` of the page."""
    entries = "".join(f"<dt>{text(term)}</dt><dd>{text(TERMS[term])}</dd>" for term in terms)
    return section("Definitions", f"<dl>{entries}</dl>")


def figure_section(figure: Drawn) -> str:
    """A figure under its question, with its caption."""
    image = f"<img alt='{text(figure.title)}' src='{embed(figure.path.read_bytes(), 'png')}'>"
    return section(figure.title, image, note(figure.caption))


def film_section(folder: Path, caption: str, name: str = "film.mp4") -> str:
    """A film of a report's folder; nothing without one."""
    film = folder / name
    if not film.is_file():
        return ""
    source = f"data:video/mp4;base64,{base64.b64encode(film.read_bytes()).decode()}"
    player = f"<video src='{source}' controls autoplay muted loop playsinline></video>"
    return f"<section>{player}{note(caption)}</section>"


def embed(data: bytes, kind: str) -> str:
    """An image as the source of an <img>."""
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"


def cell(value: Any) -> str:
    """Safe markup of a value: four figures of a float."""
    if isinstance(value, Html):
        return value
    return text(number(value) if isinstance(value, float) else value)


def text(value: Any) -> str:
    """Anything as safe text; a dash for None."""
    return html.escape("–" if value is None else str(value), quote=True)


def number(value: Any) -> str:
    """Four figures of a float; a dash for None."""
    if value is None:
        return "–"
    return str(value) if isinstance(value, (int, str)) else f"{value:.4g}"
