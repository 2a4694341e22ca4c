"""Which topics are recorded besides those that every episode has.

A request is a topic's name or a shell pattern with ``*``, ``?`` or ``[…]``; ``*`` matches slashes
too. A named topic is subscribed to from the start, with or without a publisher; topics that match
a pattern are subscribed to when they appear.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Mapping
from typing import Any

IMAGES = ("sensor_msgs/Image", "sensor_msgs/CompressedImage")
"""Types of a camera topic."""

NOT_TABLES = dict.fromkeys(IMAGES, "an image topic: name it in ~cameras")
"""Types that no table can hold → what to do."""

_WILD = frozenset("*?[")
_OURS = ("/record/",)


class TopicChoice:
    """Requested names and patterns; a ValueError for a request that is no topic.

    ``taken`` topics are recorded anyway.
    """

    def __init__(self, requests: list[str], taken: frozenset[str]) -> None:
        for request in requests:
            if not request.startswith("/") or any(c.isspace() for c in request):
                raise ValueError(
                    f"parameter ~topics has {request!r}: a name or a pattern that begins with /"
                    " is needed, e.g. /PSM1/measured_js or /PSM1/*"
                )
        self._patterns = [r for r in requests if _WILD & set(r)]
        self.named = [r for r in dict.fromkeys(requests) if not _WILD & set(r)]
        self._taken = taken
        self.refused: dict[str, str] = {
            topic: "recorded in a table of its own kind" for topic in self.named if topic in taken
        }
        """Topic → why it is not recorded here."""
        self.chosen: set[str] = {topic for topic in self.named if topic not in taken}

    def newly_chosen(self, published: Mapping[str, str]) -> list[str]:
        """Topics to subscribe to from now on; ``published`` maps topics to types."""
        appeared = []
        for topic, kind in sorted(published.items()):
            if topic in self.chosen or topic in self._taken or topic.startswith(_OURS):
                continue
            if not any(fnmatch.fnmatchcase(topic, pattern) for pattern in self._patterns):
                continue
            if kind in NOT_TABLES:
                self.refuse(topic, NOT_TABLES[kind])
            elif topic not in self.refused:
                self.chosen.add(topic)
                appeared.append(topic)
        return appeared

    def refuse(self, topic: str, why: str) -> bool:
        """Exclude a topic; True if that is new."""
        self.chosen.discard(topic)
        news = topic not in self.refused
        self.refused.setdefault(topic, why)
        return news

    def silent(self, messages: Mapping[str, int]) -> list[str]:
        """Named topics without a message (``messages`` counts), and patterns without a topic."""
        quiet = [t for t in self.named if t not in self.refused and not messages.get(t)]
        for pattern in self._patterns:
            known = {*self.chosen, *self.refused, *self._taken}
            if not any(fnmatch.fnmatchcase(topic, pattern) for topic in known):
                quiet.append(pattern)
        return quiet

    def describe(self, repeats: Mapping[str, int]) -> dict[str, dict[str, Any]]:
        """The manifest's entry of each topic, without tables; ``repeats`` counts duplicates."""
        topics = (*self.chosen, *self._patterns)
        facts: dict[str, dict[str, Any]] = {t: {"repeats": repeats.get(t, 0)} for t in topics}
        facts |= {topic: {"not_recorded": why} for topic, why in self.refused.items()}
        empty: dict[str, Any] = {"type": None, "messages": 0, "tables": []}
        return {topic: {**empty, **fact} for topic, fact in facts.items()}
