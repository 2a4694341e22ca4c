"""The pages of episodes to be labelled, and what they save."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup

from surg_console.labelling import label_file
from surg_console.web import http_policy
from surg_recording.episode import episode_reader, labels
from surg_recording.episode.episode_reader import Episode
from surg_recording.recording_errors import EpisodeError, words_of
from surg_recording.reports import episode_view
from surg_recording.reports.html_page import document, note, section

KEPT = 4
"""Pages that are kept ready, because a page with its videos is large."""


class LabelPages:
    """The episodes of a session, numbered from 1, with their pages."""

    def __init__(self, folders: Sequence[Path], by: str) -> None:
        self.folders, self._by = list(folders), by
        self._names = _names(self.folders)
        self._parts: dict[int, str] = {}
        self._lock = threading.Lock()

    def first(self) -> int:
        """The first episode without labels; the first one if all have some."""
        for number, folder in enumerate(self.folders, 1):
            if not (folder / labels.LABELS).exists():
                return number
        return 1

    def page(self, number: int) -> str:
        """The page of an episode, made now or ahead; of one that cannot be shown, the reason."""
        with self._lock:  # one at a time: the machine plays a film meanwhile
            if number not in self._parts:
                self._parts[number] = self._made(number)
                for old in list(self._parts)[:-KEPT]:
                    del self._parts[old]
            made = self._parts[number]
        return made.replace(_GIVEN, self._given(number), 1)

    def save(self, number: int, stated: Any) -> dict[str, Any]:
        """Write what a page sent into the episode's side file, and return it.

        Raises:
            ValueError: It is not allowed; names the key.
            EpisodeError: The file cannot be written.
        """
        if not isinstance(stated, dict):
            raise ValueError("labels: an object is needed")
        return label_file.save(self.folders[number - 1], _integers(stated), self._by)

    def badge(self, number: int) -> tuple[str, str, str]:
        """Kind, label and reason of the verdict that counts with the newest labels."""
        try:
            return episode_view.verdict_badge(
                episode_reader.read(self.folders[number - 1]).manifest
            )
        except EpisodeError:
            return "", "", ""

    def _made(self, number: int) -> str:
        markup = http_policy.page_files()["label/label.html"].decode()
        panel = episode_view.Panel(
            Markup("<link rel='stylesheet' href='/page/label/label.css'>{}").format(Markup(markup)),
            Markup(
                f"<script type='application/json' id='given'>{_GIVEN}</script>"
                "<script src='/page/label/label.js'></script>"
            ),
        )
        try:
            recorded = episode_reader.read(self.folders[number - 1])
            return episode_view.page(recorded, panel=panel)
        except Exception as problem:  # one recording, not the session
            return self._sorry(number, words_of(problem, self.folders[number - 1]))

    def _sorry(self, number: int, reason: str) -> str:
        links = [
            Markup("<a href='{}' rel='{}'>{}</a>").format(place, word, word)
            for word, place in (
                ("back", self._place(number - 1)),
                ("next", self._place(number + 1)),
            )
            if place
        ]
        keys = Markup(
            "<script>document.addEventListener('keydown', (event) => {"
            " const link = document.querySelector(event.shiftKey ? '[rel=back]' : '[rel=next]');"
            " if (event.key === 'Enter' && link) location.assign(link.href); });</script>"
        )
        shown = section("This episode cannot be shown", note(reason), Markup(" ").join(links))
        return document(f"Episode {number}", [shown, keys])

    def _place(self, number: int) -> str | None:
        return f"/episode/{number}" if 1 <= number <= len(self.folders) else None

    def _given(self, number: int) -> str:
        """What the page's script starts with, as JSON; the newest labels."""
        folder = self.folders[number - 1]
        try:
            recorded: Episode | None = episode_reader.read(folder)
        except EpisodeError:
            recorded = None
        known: Mapping[str, Any] = {} if recorded is None else recorded.manifest
        stated = known.get(labels.KEY) or {}
        trim = stated.get("trim") or {}
        run = known.get("run") or {}
        given = {
            "place": f"{number} of {len(self.folders)} · {self._names[number - 1]}",
            "back": self._place(number - 1),
            "next": self._place(number + 1),
            "success": stated.get("success"),
            "badge": episode_view.verdict_badge(known) if recorded else ("", "", ""),
            "note": stated.get("note", ""),
            "names": list(run.get("stages") or {}),
            "stages_edited": stated.get("stages") is not None,
            "stages": [
                {
                    "name": stage["name"],
                    "begin_ns": str(stage["begin_ns"]),
                    "end_ns": None if stage["end_ns"] is None else str(stage["end_ns"]),
                }
                for stage in ([] if recorded is None else recorded.stages)
                if stage.get("begin_ns") is not None
            ],
            "trim": [
                None if trim.get(key) is None else str(trim[key]) for key in ("begin_ns", "end_ns")
            ],
        }
        return json.dumps(given).replace("<", "\\u003c")


_GIVEN = "@GIVEN@"


def _names(folders: Sequence[Path]) -> list[str]:
    """What tells the episodes apart: ``003`` for ``…/episodes/003/episode``."""
    resolved = [folder.resolve() for folder in folders]
    own = [each.parent if each.name == "episode" else each for each in resolved]
    common = Path(os.path.commonpath([each.parent for each in own])) if own else Path()
    return [str(each.relative_to(common)) for each in own]


def _integers(stated: Mapping[str, Any]) -> dict[str, Any]:
    """The same with stamps as integers: a page sends them as texts, its numbers are too short."""

    def convert(value: Any) -> Any:
        if isinstance(value, dict):
            return {
                key: int(each)
                if key.endswith("_ns") and isinstance(each, str) and each.isdecimal()
                else convert(each)
                for key, each in value.items()
            }
        return [convert(each) for each in value] if isinstance(value, list) else value

    return {str(key): convert(value) for key, value in stated.items()}
