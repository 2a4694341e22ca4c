"""Whether an episode succeeded: the one place that decides it.

A label given after the recording counts first, then a person's verdict: of ``./surg record stop``,
or of the tag ``failure``. Without one the simulated task's counts; a real robot has none. A
disagreement is stated.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

FAILURE_TAG = "failure"
PERSON, TASK = "person", "task"
"""Who judged; ``task`` is also what a result of the simulated task has as ``by``."""


@dataclasses.dataclass(frozen=True)
class Verdict:
    """How an episode ended.

    Attributes:
        success: None: nobody judged it.
        reason: Why it failed; empty for a success.
        by: ``person`` or ``task``; None: nobody.
        disagreement: What the others say, in words; None if they agree.
    """

    success: bool | None
    reason: str = ""
    by: str | None = None
    disagreement: str | None = None


NOT_JUDGED = Verdict(None)


def verdict(manifest: Mapping[str, Any]) -> Verdict:
    """The verdict on an episode, by its manifest."""
    label, persons, task = _of_the_label(manifest), _of_persons(manifest), _of_the_task(manifest)
    judged = [*label, *persons, *([task] if task else [])]
    if not judged:
        return NOT_JUDGED
    # Two verdicts of persons: what somebody called a failure is no success.
    failed = next((each for each in persons if not each.success), judged[0])
    first = label[0] if label else failed
    others = [each for each in judged if each.success != first.success]
    if not others:
        return first
    said = "; ".join(f"by {each.by}: {_words(each)}" for each in (first, *others))
    return dataclasses.replace(first, disagreement=said)


def has_tag(manifest: Mapping[str, Any], text: str) -> bool:
    """Whether an episode has a tag of this text; a tag is a text or an object."""
    tags = manifest.get("tags")
    listed = tags if isinstance(tags, list) else []
    return any((tag.get("text") if isinstance(tag, dict) else tag) == text for tag in listed)


def _of_the_label(manifest: Mapping[str, Any]) -> list[Verdict]:
    """Of ``labels.json``: it was given with the film at hand, and so replaces earlier ones."""
    labels = _mapping(manifest.get("labels"))
    success = labels.get("success")
    if success is None:
        return []
    return [Verdict(success, "" if success else str(labels.get("note") or ""), PERSON)]


def _of_persons(manifest: Mapping[str, Any]) -> list[Verdict]:
    result = _mapping(manifest.get("result"))
    found = []
    if result.get("success") is not None and result.get("by") != TASK:
        success = result["success"] is True
        found.append(Verdict(success, "" if success else str(result.get("reason") or ""), PERSON))
    if has_tag(manifest, FAILURE_TAG):
        found.append(Verdict(False, f"tag {FAILURE_TAG}", PERSON))
    return found


def _of_the_task(manifest: Mapping[str, Any]) -> Verdict | None:
    task = _mapping(_mapping(manifest.get("sim")).get("task"))
    if task.get("success") is None:
        return None
    success = task["success"] is True and task.get("done", True) is True
    return Verdict(success, "" if success else str(task.get("reason") or ""), TASK)


def _words(verdict: Verdict) -> str:
    if verdict.success:
        return "success"
    return f"failure ({verdict.reason})" if verdict.reason else "failure"


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}
