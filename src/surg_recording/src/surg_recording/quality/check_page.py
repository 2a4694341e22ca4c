"""The findings of a data set: ``check.json``, and a page with a figure for people."""

from __future__ import annotations

import dataclasses
import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from surg_recording.quality.set_rows import WHOLE, Finding
from surg_recording.reports import figure_style, html_page

JSON, PAGE = "check.json", "check.html"
MOST = 500
"""Findings that the page lists; the JSON has all."""


def write(out: Path, root: Path, episodes: int, found: Sequence[Finding]) -> Path:
    """Write both files into a folder that exists; returns the page."""
    entries = [dataclasses.asdict(each) for each in found]
    stated = {"data_set": str(root), "episodes": episodes, "findings": entries}
    (out / JSON).write_text(json.dumps(stated, indent=1) + "\n", "utf-8")
    sections = [_summary(episodes, found)]
    if found:
        data, kind = figure_style.encoded(figure(episodes, found))
        caption = "Each mark is an episode with such a finding."
        sections.append(
            html_page.section("Where", html_page.picture(data, kind, "findings", caption))
        )
        rows = [
            ("set" if each.episode == WHOLE else each.episode, each.kind, each.where, each.what)
            for each in found[:MOST]
        ]
        head = ("episode", "what", "where", "how")
        sections.append(html_page.section("Findings", html_page.table(head, rows, right=(0,))))
    page = out / PAGE
    page.write_text(html_page.document("Data set", sections, str(root)), "utf-8")
    return page


def _summary(episodes: int, found: Sequence[Finding]) -> str:
    if not found:
        return html_page.section("Nothing found", f"{episodes} episodes", verdict="ok")
    kinds = Counter(each.kind for each in found)
    touched = len({each.episode for each in found} - {WHOLE})
    words = f"{len(found)} findings in {touched} of {episodes} episodes"
    return html_page.section(words, html_page.facts(kinds.most_common()), verdict="bad")


def figure(episodes: int, found: Sequence[Finding]) -> Figure:
    """Kinds of findings over the episodes."""
    kinds = [kind for kind, _ in Counter(each.kind for each in found).most_common()]
    made = figure_style.blank(0.9 + 0.28 * len(kinds))
    axes = made.subplots()
    at = [(each.episode, kinds.index(each.kind)) for each in found]
    axes.scatter(*zip(*at, strict=True), marker="|", s=90, color=figure_style.LIMIT)
    axes.set(xlim=(WHOLE - 0.5, max(episodes, 1) - 0.5), xlabel="episode; -1: the whole set")
    axes.set_yticks(range(len(kinds)), kinds)
    axes.set_ylim(len(kinds) - 0.5, -0.5)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    return made
