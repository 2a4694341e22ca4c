"""The score card of a policy: one JSON file that others can repeat, and check by its hash.

format    "surg_card/1"
kind      "quick" or "full"
policy    {name, sha256: of its files, or null, shut_in: its process could reach nothing else}
platform  what the figures depend on: versions by name
seeds     of the episodes of each cell
cells     [{task, condition, blind, served, n, k, low, high, failures, means, rejected,
            counts, episodes}]: Wilson's 95 % interval; units in the names, SI
machine   processor, date and latencies: all that may differ between two runs
sha256    of all the rest but ``machine``
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from surg_recording.metrics.confidence_intervals import success_rate
from surg_recording.recording_errors import EpisodeError

FORMAT = "surg_card/1"
KINDS = ("quick", "full")
MEASURES = (
    *("duration_s", "rcm_mean_m", "rcm_max_m", "rcm_true_max_m"),
    *("trocar_force_mean_n", "trocar_force_max_n", "tip_force_mean_n", "tip_force_max_n"),
    *("path_m", "sparc"),
)
"""Numbers of an episode; null where there was nothing to measure."""
COUNTS = ("accepted", "clipped", "late", "stale", "empty", "refused")
"""Of an episode: the model server's, and the commands that the controller refused."""

Entry = Mapping[str, Any]
_OUTSIDE = ("machine", "sha256")
_TOP: dict[str, type] = {
    **dict.fromkeys(("format", "kind", "sha256"), str),
    **dict.fromkeys(("policy", "platform", "machine"), dict),
    **dict.fromkeys(("seeds", "cells"), list),
}
_POLICY: dict[str, type] = {"name": str, "shut_in": bool}
_SERVED: dict[str, type] = {"key": str, "privileged": bool}
_CELL: dict[str, type] = {
    **dict.fromkeys(("task", "condition"), str),
    "blind": bool,
    **dict.fromkeys(("served", "episodes"), list),
    **dict.fromkeys(("n", "k"), int),
    **dict.fromkeys(("failures", "means", "rejected", "counts"), dict),
}
_EPISODE: dict[str, type] = {
    **dict.fromkeys(("reason", "phase"), str),
    "success": bool,
    "rejected": dict,
    **dict.fromkeys(("seed", *COUNTS), int),
}


def cell(task: str, condition: str, blind: bool, played: Entry) -> dict[str, Any]:
    """The entry of a cell from its ``served`` and its ``episodes``."""
    episodes = played["episodes"]
    rejected: Counter[str] = Counter()
    for episode in episodes:
        rejected.update(episode["rejected"])
    return {
        "task": task,
        "condition": condition,
        "blind": blind,
        "served": played["served"],
        **success_rate([episode["success"] for episode in episodes]),
        "failures": dict(Counter(e["reason"] for e in episodes if not e["success"])),
        "means": {name: _mean([e[name] for e in episodes]) for name in MEASURES},
        "rejected": dict(sorted(rejected.items())),
        "counts": {name: sum(e[name] for e in episodes) for name in COUNTS},
        "episodes": list(episodes),
    }


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return math.fsum(known) / len(known) if known else None


def card(
    kind: str, policy: Entry, platform: Entry, seeds: Sequence[int], cells: Sequence[Entry]
) -> dict[str, Any]:
    """A card without its machine, with its hash."""
    made = {
        "format": FORMAT,
        "kind": kind,
        "policy": dict(policy),
        "platform": dict(platform),
        "seeds": list(seeds),
        "cells": list(cells),
    }
    return {**made, "machine": {}, "sha256": digest(made)}


def digest(content: Entry) -> str:
    """SHA-256 of what two runs have in common."""
    kept = {key: value for key, value in content.items() if key not in _OUTSIDE}
    words = json.dumps(kept, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(words.encode()).hexdigest()


def check(place: object, content: Any) -> None:
    """Check a card that somebody sent.

    Raises:
        EpisodeError: A key is missing or of another type, a figure does not follow from the
            episodes, or the hash is another; names file and key.
    """
    _check_object(place, content, _TOP)
    if content["format"] != FORMAT or content["kind"] not in KINDS:
        said = f"{content['format']!r}, {content['kind']!r}"
        raise EpisodeError(
            f"{place}: format, kind: {said}; allowed: {FORMAT}, {' or '.join(KINDS)}"
        )
    _check_object(f"{place}: policy", content["policy"], _POLICY)
    for n, stated in enumerate(content["cells"]):
        where = f"{place}: cells[{n}]"
        _check_object(where, stated, _CELL)
        if not re.fullmatch(r"\w+", stated["task"]):  # a figure's file gets its name
            raise EpisodeError(f"{where}.task: {stated['task']!r}; allowed: letters, digits and _")
        for i, served in enumerate(stated["served"]):
            _check_object(f"{where}.served[{i}]", served, _SERVED)
        for i, episode in enumerate(stated["episodes"]):
            _check_object(f"{where}.episodes[{i}]", episode, _EPISODE)
            _check_numbers(f"{where}.episodes[{i}]", episode)
        again = cell(stated["task"], stated["condition"], stated["blind"], stated)
        for key, value in again.items():
            if stated.get(key) != value:
                raise EpisodeError(
                    f"{where}.{key}: {stated.get(key)!r}; its episodes give {value!r}"
                )
        if (seeds := [e["seed"] for e in stated["episodes"]]) != content["seeds"]:
            raise EpisodeError(f"{where}: seeds {seeds}; the card's are {content['seeds']}")
    if (found := digest(content)) != content["sha256"]:
        raise EpisodeError(f"{place}: sha256: {content['sha256']!r}; its content has {found!r}")


def _check_object(place: object, value: Any, keys: Mapping[str, type]) -> None:
    if not isinstance(value, dict):
        raise EpisodeError(f"{place}: {type(value).__name__}; allowed: an object")
    for key, kind in keys.items():
        if type(value.get(key)) is not kind:  # a bool is no int here
            raise EpisodeError(f"{place}.{key}: {value.get(key)!r}; allowed: {kind.__name__}")


def _check_numbers(place: object, episode: Entry) -> None:
    for name in MEASURES:
        value = episode.get(name)
        if value is not None and not (type(value) in (int, float) and abs(value) < 1e100):
            raise EpisodeError(f"{place}.{name}: {value!r}; allowed: a finite number or null")
