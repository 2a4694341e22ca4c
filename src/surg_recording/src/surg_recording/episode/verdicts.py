"""How an episode ended: the one place that decides it.

======== ==========================================================================
success  the task was solved
failure  it was not, or the arm was in FAULT
aborted  the task did not come to its end: stopped early, or a part of the system died
crashed  the program of the policy died; what it might have done is not known
not judged  nobody has judged it, and no simulated task did
======== ==========================================================================

A label given after the recording counts first, then a person's verdict: of ``./surg record stop``,
or of the tag ``failure``. Without one the simulated task's counts; a real robot has none. A
disagreement is stated.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

FAILURE_TAG = "failure"
SUCCESS, FAILURE, ABORTED, CRASHED = "success", "failure", "aborted", "crashed"
UNJUDGED = "not judged"
OUTCOME = "outcome"
"""Key under ``run`` for how a run says that it ended: a map of ``outcome`` and ``reason``."""
PERSON, TASK = "person", "task"
"""Who judged; ``task`` is also what a result of the simulated task has as ``by``."""


@dataclasses.dataclass(frozen=True)
class Verdict:
    """How an episode ended.

    Attributes:
        success: None: aborted, crashed or not judged.
        reason: Why it was no success; empty for a success.
        by: ``person`` or ``task``; None: nobody.
        disagreement: What the others say, in words; None if they agree.
    """

    success: bool | None
    reason: str = ""
    by: str | None = None
    disagreement: str | None = None
    broken_off: str = UNJUDGED
    """What it is if ``success`` is None."""

    @property
    def outcome(self) -> str:
        """The word for it."""
        if self.success is None:
            return self.broken_off
        return SUCCESS if self.success else FAILURE


NOT_JUDGED = Verdict(None)


def verdict(manifest: Mapping[str, Any]) -> Verdict:
    """The verdict on an episode, by its manifest."""
    label, persons, task = _of_the_label(manifest), _of_persons(manifest), _of_the_task(manifest)
    judged = [*label, *persons, *([task] if task else [])]
    if not judged:
        return _broken_off(manifest)
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
    """Of the simulated task; of a run that ended otherwise, such as by a FAULT, the run's."""
    run = _mapping(_mapping(manifest.get("run")).get(OUTCOME))
    if run.get("outcome") == FAILURE:
        return Verdict(False, str(run.get("reason") or ""), TASK)
    task = _mapping(_mapping(manifest.get("sim")).get("task"))
    if task.get("success") is None or task.get("done", True) is not True or run:
        return None
    success = task["success"] is True
    return Verdict(success, "" if success else str(task.get("reason") or ""), TASK)


def _broken_off(manifest: Mapping[str, Any]) -> Verdict:
    """Of an episode that nobody judged."""
    run = _mapping(_mapping(manifest.get("run")).get(OUTCOME))
    if run.get("outcome") in (ABORTED, CRASHED):
        reason = str(run.get("reason") or "")
        return Verdict(None, reason, broken_off=str(run["outcome"]))
    sim = _mapping(manifest.get("sim"))
    if sim.get("aborted"):
        return Verdict(None, f"the simulator aborted: {sim['aborted']}", broken_off=ABORTED)
    if _mapping(sim.get("task")).get("done", True) is not True:
        return Verdict(None, "it was stopped before the task was over", broken_off=ABORTED)
    return NOT_JUDGED


def _words(verdict: Verdict) -> str:
    if verdict.success:
        return "success"
    return f"failure ({verdict.reason})" if verdict.reason else "failure"


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}
