"""A self-contained HTML page: its frame, its style and the small things that fill it."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable
from typing import Any

from surg_recording.reports.run_figures import Drawn

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
img { max-width: 100%; height: auto; display: block; }
.strip { display: grid; grid-template-columns: repeat(3, 1fr); gap: 8px; }
.strip figure { margin: 0; } figcaption { color: #5f6c7b; font-size: 13px; }
dt { font-weight: 600; margin-top: 8px; } dd { margin: 0 0 4px; }
code { font-size: 13px; overflow-wrap: anywhere; }
"""


def document(title: str, sections: Iterable[str]) -> str:
    """The page with this title around these sections of HTML."""
    return (
        "<!DOCTYPE html>\n<html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width, initial-scale=1'>"
        f"<title>{text(title)}</title><style>{CSS}</style></head>\n<body><main>\n"
        + "\n".join(sections)
        + "\n</main></body></html>\n"
    )


def definitions(terms: Iterable[tuple[str, str]]) -> str:
    """A section that defines the terms of the page."""
    entries = "".join(f"<dt>{text(term)}</dt><dd>{text(meaning)}</dd>" for term, meaning in terms)
    return f"<section><h2>Definitions</h2><dl>{entries}</dl></section>"


def figure_section(figure: Drawn) -> str:
    """A figure under its question, with its caption."""
    image = embed(figure.path.read_bytes(), "png")
    return (
        f"<section><h2>{text(figure.title)}</h2>"
        f"<img alt='{text(figure.title)}' src='{image}'>"
        f"<p class='faint small'>{text(figure.caption)}</p></section>"
    )


def embed(data: bytes, kind: str) -> str:
    """An image as the source of an <img>."""
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"


def text(value: Any) -> str:
    """Anything as safe text; a dash for None."""
    return html.escape("–" if value is None else str(value), quote=True)


def number(value: Any) -> str:
    """Four figures of a float; a dash for None."""
    if value is None:
        return "–"
    return str(value) if isinstance(value, (int, str)) else f"{value:.4g}"
