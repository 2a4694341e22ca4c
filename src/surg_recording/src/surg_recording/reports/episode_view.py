"""Makes the page of an episode: video, tip path and curves under a common cursor.

``page`` fills ``templates/episode_view.html`` with what ``episode_view_data`` collects: a single
HTML file that needs no network.
"""

from __future__ import annotations

import base64
import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup

from surg_recording.clock import sync_report
from surg_recording.episode.episode_reader import Episode
from surg_recording.episode.verdicts import UNJUDGED, verdict
from surg_recording.recording_errors import EpisodeError
from surg_recording.reports import episode_view_data
from surg_recording.reports.episode_view_data import MAX_ROWS, VIDEO_BUDGET, Progress
from surg_recording.reports.html_page import TEMPLATES
from surg_recording.reports.terms import named


@dataclasses.dataclass(frozen=True)
class Panel:
    """Markup below the videos, and what follows the script of the page."""

    markup: Markup
    after: Markup


def page(
    episode: Episode,
    budget: int = VIDEO_BUDGET,
    max_rows: int = MAX_ROWS,
    progress: Progress | None = None,
    panel: Panel | None = None,
) -> str:
    """The page of an episode (see ``collect``); an EpisodeError if there is nothing to show.

    ``panel`` adds what a program of its own needs on the page, such as that of labels.
    """
    viewed = episode_view_data.collect(episode, budget, max_rows, progress)
    info = episode.manifest.get("run") or {}
    subject = info.get("title") or info.get("motion") or episode.manifest.get("task") or "episode"
    title = " · ".join(
        named(part) for part in (subject, info.get("robot"), info.get("setting")) if part
    )
    data = json.dumps(viewed.data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return TEMPLATES.get_template("episode_view.html").render(
        title=title,
        created=episode.manifest.get("created"),
        folder=episode.folder.name,
        badges=_badges(episode),
        notes=viewed.missing,
        panel=panel,
        videos=[Markup(base64.b64encode(video).decode()) for video in viewed.videos],
        data=Markup(data),
    )


@dataclasses.dataclass(frozen=True)
class Badge:
    """A word about an episode; ``kind`` is pass, fail or cannot_tell and gives it a colour."""

    kind: str
    label: str
    why: str
    id: str = ""


def verdict_badge(manifest: Mapping[str, Any]) -> tuple[str, str, str]:
    """Kind, label and reason of the badge that states how the episode ended."""
    judged = verdict(manifest)
    if judged.outcome == UNJUDGED:
        return "cannot_tell", UNJUDGED, "nobody has judged it"
    said = ": ".join(filter(None, (judged.by and f"by {judged.by}", judged.reason)))
    label = judged.outcome + (", verdicts disagree" if judged.disagreement else "")
    return "pass" if judged.success else "fail", label, judged.disagreement or said


def _badges(episode: Episode) -> list[Badge]:
    """Badges: is the recording complete, and are its streams synchronised?"""
    outcome = str(episode.manifest.get("outcome"))
    reason = episode.manifest.get("reason") or "nothing was lost"
    badges = [
        Badge("pass" if outcome == "complete" else "fail", f"files {outcome}", reason),
        # It has an id: the label page changes it.
        Badge(*verdict_badge(episode.manifest), id="judged"),
    ]
    sync = sync_report.load(episode)
    if sync is not None:
        words = {"pass": "in sync", "fail": "OUT OF SYNC", "cannot_tell": "sync: unknown"}
        why = "; ".join(sync.get("reasons") or []) or "all streams are synchronised"
        badges.append(Badge(sync["verdict"], words.get(sync["verdict"], sync["verdict"]), why))
    return badges


def write(episode: Episode, out: Path, progress: Progress | None = None) -> Path:
    """Write the page of an episode and return its path; an EpisodeError if that fails."""
    content = page(episode, progress=progress)
    try:
        out.write_text(content, encoding="utf-8")
    except OSError as problem:
        raise EpisodeError(f"{out}: cannot be written: {problem.strerror}") from problem
    return out
