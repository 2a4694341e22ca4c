"""What the tests read in Markdown pages: links, headings, command lines and sentences."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote

_FENCE = re.compile(r"^ *(```|~~~)(\w*)[^\n]*\n(.*?)^ *\1 *$", re.DOTALL | re.MULTILINE)
_LINK = re.compile(r"\[(?:[^\[\]]|\[[^\]]*\])*\]\(<?([^()\s>]+)>?(?:\s+\"[^\"]*\")?\)")
_END_OF_SENTENCE = re.compile(r"(?<=[.!?])\s+(?=[A-Z0-9`*_\[(\"])")


def without_code(text: str) -> str:
    """A page whose code blocks and code spans are blank; its lines stay."""
    blank = _FENCE.sub(lambda match: "\n" * match.group().count("\n"), text)
    return re.sub(r"(`+)(?:(?!\1).)+\1", "`x`", blank)


def links(text: str) -> list[str]:
    """Targets of a page's links and pictures that are no web addresses."""
    targets = _LINK.findall(without_code(text))
    targets += re.findall(r"^\[[^\]]+\]:\s*(\S+)", without_code(text), re.MULTILINE)
    targets += re.findall(r"<(?:img|source)[^>]*\bsrc(?:set)?=\"([^\"]+)\"", text)
    return [target for target in targets if not re.match(r"[a-z][a-z0-9+.-]*:", target)]


def anchors(text: str) -> set[str]:
    """Anchors of a page's headings as GitHub makes them."""
    found: set[str] = set()
    blank = _FENCE.sub("", text)
    for heading in re.findall(r"^#{1,6}\s+(.+?)\s*#*$", blank, re.MULTILINE):
        words = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower()
        slug = re.sub(r"[^\w\- ]", "", words).replace(" ", "-")
        number = 0
        unique = slug
        while unique in found:
            number += 1
            unique = f"{slug}-{number}"
        found.add(unique)
    return found | set(re.findall(r"<a (?:id|name)=\"([^\"]+)\"", text))


def broken_links(page: Path, text: str) -> list[str]:
    """Relative links of a page that lead nowhere."""
    broken = []
    for target in links(text):
        path, _, anchor = unquote(target).partition("#")
        file = page.parent / path if path else page
        if file != page and not file.exists():
            broken.append(target)
        elif anchor and file.suffix == ".md":
            content = text if file == page else file.read_text("utf-8")
            if anchor not in anchors(content):
                broken.append(target)
    return broken


def surg_lines(text: str) -> Iterator[list[str]]:
    """Words behind `./surg` of the command lines in a page's `sh` blocks."""
    for _, language, block in _FENCE.findall(text):
        if language not in ("sh", "bash"):
            continue
        for line in re.sub(r"\\\n", " ", block).splitlines():
            words = shlex.split(line, comments=True)
            while words and re.match(r"[A-Z_]+=", words[0]):  # variables before the command
                words = words[1:]
            if words and words[0] == "./surg":
                ends = [i for i, word in enumerate(words) if word in ("&", "&&", ";", "|", ">")]
                yield words[1 : ends[0] if ends else None]


def mean_sentence_length(text: str) -> float:
    """Words per sentence of a page's prose, 0 without any.

    Headings, tables, code blocks and pictures are no prose. A list's item is a sentence of its own.
    """
    lengths = [len(words.split()) for words in _sentences(text)]
    return sum(lengths) / len(lengths) if lengths else 0.0


def _sentences(text: str) -> Iterator[str]:
    prose = re.sub(r"<!--.*?-->", "", without_code(text), flags=re.DOTALL)
    blocks: list[str] = [""]
    for line in prose.splitlines():
        content = line.strip()
        if not content or re.match(r"#|\||<|!\[|-{3,}|={3,}", content):
            blocks.append("")
            continue
        item = re.match(r"(?:[-*+]|\d+\.)\s+(.*)", content)
        if item:
            blocks.append(item.group(1))
        else:
            blocks[-1] += f" {content.lstrip('> ')}"
    for block in blocks:
        plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", block).strip()
        for sentence in _END_OF_SENTENCE.split(plain):
            if re.search(r"\w{2}", sentence):
                yield sentence
