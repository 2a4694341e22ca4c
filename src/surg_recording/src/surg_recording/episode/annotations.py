"""Annotations of an episode: stages, tags, a verdict, facts for the manifest.

``/record/tag`` carries a text, which is a tag, or a JSON object with any of the keys ``tag``,
``stage`` (a new stage begins; empty: none), ``success`` (true, false or null) with ``reason``, and
``stamp_ns``. ``/record/info`` carries a JSON object of facts: ``operator``, ``task``, ``setting``,
``seed`` or anything else for the manifest's ``run``.

A simulated task reports its phase. Its phases are the stages of an episode in which no person
marked a stage.
"""

from __future__ import annotations

import dataclasses
import json
from typing import Any

from surg_recording.episode.verdicts import TASK

KEYS = ("tag", "stage", "success", "reason", "stamp_ns")

MAX_TEXT = 1000
"""Longest tag, name of a stage, or reason."""

MAX_INFO = 16_384
"""Longest /record/info."""


@dataclasses.dataclass(frozen=True)
class Tag:
    """One message of /record/tag; None: not stated."""

    tag: str | None = None
    stage: str | None = None
    success: bool | None = None
    judged: bool = False
    """``success`` is stated; null means unknown."""
    reason: str = ""
    stamp_ns: int | None = None


def parse_tag(text: str) -> Tag:
    """Read one message of /record/tag; a ValueError states what is wrong and what is allowed."""
    text = text.strip()
    if not text:
        raise ValueError('an empty tag; give a text, or JSON such as {"stage": "approach"}')
    if not text.startswith("{"):
        return Tag(tag=_text(text, "tag"))
    try:
        stated = json.loads(text)
    except (ValueError, RecursionError) as problem:
        raise ValueError(f"a tag that begins with {{ must be JSON ({problem})") from None
    unknown = sorted(set(stated) - set(KEYS))
    if unknown or not stated:
        named = f"key {unknown[0]!r} is unknown" if unknown else "no key"
        raise ValueError(f"tag: {named}; allowed are {', '.join(KEYS)}")
    success = stated.get("success")
    if not (success is None or isinstance(success, bool)):
        raise ValueError(f"tag: success is {success!r}, allowed are true, false and null")
    stamp = stated.get("stamp_ns")
    if not (stamp is None or (type(stamp) is int and 0 <= stamp < 2**63)):
        raise ValueError(f"tag: stamp_ns is {stamp!r}, must be an integer of nanoseconds >= 0")
    return Tag(
        tag=_text(stated["tag"], "tag") if "tag" in stated else None,
        stage=_text(stated["stage"] or "", "stage") if "stage" in stated else None,
        success=success,
        judged="success" in stated,
        reason=_text(stated.get("reason") or "", "reason"),
        stamp_ns=stamp,
    )


def parse_info(text: str) -> dict[str, Any]:
    """Read one message of /record/info; a ValueError states what is wrong and what is allowed."""
    if len(text) > MAX_INFO:
        raise ValueError(f"info of {len(text)} characters; at most {MAX_INFO} are taken")
    try:
        facts = json.loads(text)
    except (ValueError, RecursionError) as problem:
        raise ValueError(f"info must be a JSON object ({problem})") from None
    if not isinstance(facts, dict):
        raise ValueError('info must be a JSON object, such as {"operator": "A"}')
    return facts


class Annotations:
    """Stages, tags and verdict of one episode, as in the manifest."""

    def __init__(self) -> None:
        self.tags: list[dict[str, Any]] = []
        self._marked: list[dict[str, Any]] = []
        self._phases: list[dict[str, Any]] = []
        self.result: dict[str, Any] = {"success": None, "reason": "", "by": None}

    def add(self, tag: Tag, stamp_ns: int, by: str) -> None:
        """Add a tag received at ``stamp_ns`` [ns]; its own stamp takes precedence."""
        stamp = stamp_ns if tag.stamp_ns is None else tag.stamp_ns
        if tag.tag is not None:
            self.tags.append({"stamp_ns": stamp, "text": tag.tag, "by": by})
        if tag.stage is not None:
            _begin(self._marked, tag.stage, stamp, by)
        if tag.judged:
            self.result = {"success": tag.success, "reason": tag.reason, "by": by}

    def phase(self, name: str, stamp_ns: int, done: bool) -> None:
        """The phase of the simulated task at ``stamp_ns`` [ns]; the last one ends with the task."""
        name = "" if done else name
        if name != _current(self._phases):
            _begin(self._phases, name, stamp_ns, TASK)

    @property
    def stage(self) -> str | None:
        """The current stage; None: there is none."""
        return _current(self._marked or self._phases) or None

    def stages(self, run: Any = None) -> list[dict[str, Any]]:
        """The stages: those that a person marked, else the task's phases.

        ``run`` is the manifest's entry: its ``stages`` give a stage's sentence by name.
        """
        texts = run.get("stages") if isinstance(run, dict) else None
        texts = texts if isinstance(texts, dict) else {}
        return [
            {**stage, **({"text": texts[stage["name"]]} if stage["name"] in texts else {})}
            for stage in self._marked or self._phases
        ]

    def end(self, stamp_ns: int) -> None:
        """End the current stage."""
        for stages in (self._marked, self._phases):
            _begin(stages, "", stamp_ns, "")

    def judged(self, task: Any) -> dict[str, Any]:
        """The verdict: a person's if there is one, else the simulated task's."""
        if self.result["by"] is None and isinstance(task, dict) and task.get("done"):
            reason = str(task.get("reason") or "")
            return {"success": task.get("success"), "reason": reason, "by": TASK}
        return self.result


def _begin(stages: list[dict[str, Any]], name: str, stamp_ns: int, by: str) -> None:
    """End the current stage at ``stamp_ns`` [ns], and begin another unless ``name`` is empty."""
    if stages and stages[-1]["end_ns"] is None:
        stages[-1]["end_ns"] = max(stamp_ns, stages[-1]["begin_ns"])
    if name:
        stages.append({"name": name, "begin_ns": stamp_ns, "end_ns": None, "by": by})


def _current(stages: list[dict[str, Any]]) -> str:
    return str(stages[-1]["name"]) if stages and stages[-1]["end_ns"] is None else ""


def _text(value: Any, key: str) -> str:
    if not isinstance(value, str):
        raise ValueError(f"tag: {key} is {value!r}, must be a text")
    if len(value) > MAX_TEXT:
        raise ValueError(f"tag: {key} has {len(value)} characters, at most {MAX_TEXT} are taken")
    return value
