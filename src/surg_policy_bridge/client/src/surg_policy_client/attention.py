"""What a policy says that it sees: points and a map in a picture, its phase, its confidence.

It is for people, who watch why an arm moves. Nothing acts on it, and what is invalid is dropped
without any effect on the actions beside it (docs/reference/protocol.md).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Mapping, Sequence

import numpy as np

VERSION = 1
MAX_KEYPOINTS = 16
MAX_NAME = 32
"""[characters] Longest name of a keypoint or a phase."""
MAX_KEY = 128
MAX_SIDE = 32
"""Cells of a side of the map."""
NEAR = 2.0
"""Largest place, so that a point just outside the picture can be told."""
WHOLE = (0.0, 0.0, 1.0, 1.0)
FIELDS = ("version", "picture", "phase", "confidence", "keypoints", "area")


class AttentionError(ValueError):
    """It must not be told; the message names the place and what is allowed."""


@dataclass(frozen=True)
class Keypoint:
    """A point in the picture.

    Attributes:
        name: Of 1 to 32 characters, such as ``tip``.
        x: To the right, as a share of the picture's width; 0 is its left edge.
        y: Down, as a share of its height; 0 is its upper edge.
        confidence: 0 to 1.
    """

    name: str
    x: float
    y: float
    confidence: float = 1.0


@dataclass(frozen=True)
class Attention:
    """What a policy saw in one observation.

    Attributes:
        keypoints: At most 16.
        phase: Of the task, in the policy's own words; empty: not said.
        confidence: In what it does, 0 to 1; None: not said.
        picture: Key of the observation that the places are in; empty: there are none.
        heat_map: (h, w) uint8, at most 32 x 32: where it looks, 255 the most; None: not said.
        area: Left, top, right, bottom of that map, as shares of the picture.
    """

    keypoints: Sequence[Keypoint] = ()
    phase: str = ""
    confidence: float | None = None
    picture: str = ""
    heat_map: np.ndarray | None = field(default=None, compare=False)
    area: tuple[float, float, float, float] = WHOLE


def to_wire(seen: Attention) -> tuple[dict[str, Any], np.ndarray | None]:
    """The fields and the heat map of an ACT.

    Raises:
        AttentionError: It must not be told.
    """
    points = [[p.name, float(p.x), float(p.y), float(p.confidence)] for p in seen.keypoints]
    head = {
        "version": VERSION,
        "picture": seen.picture,
        "phase": seen.phase,
        "confidence": None if seen.confidence is None else float(seen.confidence),
        "keypoints": points,
        "area": [float(each) for each in seen.area],
    }
    attention = None if seen.heat_map is None else np.asarray(seen.heat_map, order="C")
    from_wire(head, attention)
    return head, attention


def from_wire(head: Any, attention: np.ndarray | None) -> Attention:
    """What an ACT says; the inverse of `to_wire`.

    Raises:
        AttentionError: It must not be believed.
    """
    if type(head) is not dict or head.keys() != set(FIELDS):
        raise AttentionError(f"seen: a map with exactly {', '.join(FIELDS)}")
    if head["version"] != VERSION:
        raise AttentionError(f"seen.version: {VERSION}, not {head['version']!r:.40}")
    points = head["keypoints"]
    if type(points) is not list or len(points) > MAX_KEYPOINTS:
        raise AttentionError(f"seen.keypoints: a list of at most {MAX_KEYPOINTS}")
    area = head["area"]
    if type(area) is not list or len(area) != 4 or not all(_within(v, 0.0, 1.0) for v in area):
        raise AttentionError("seen.area: [left, top, right, bottom], each 0 to 1")
    if not (area[0] < area[2] and area[1] < area[3]):
        raise AttentionError("seen.area: left before right, top before bottom")
    confidence = head["confidence"]
    if confidence is not None and not _within(confidence, 0.0, 1.0):
        raise AttentionError("seen.confidence: nil, or 0 to 1")
    _text(head, "picture", MAX_KEY)
    _text(head, "phase", MAX_NAME)
    if attention is not None:
        _check_map(attention)
    return Attention(
        keypoints=tuple(_keypoint(n, point) for n, point in enumerate(points)),
        phase=head["phase"],
        confidence=confidence,
        picture=head["picture"],
        heat_map=attention,
        area=(area[0], area[1], area[2], area[3]),
    )


def _keypoint(number: int, point: Any) -> Keypoint:
    good = (
        type(point) is list
        and len(point) == 4
        and type(point[0]) is str
        and 0 < len(point[0]) <= MAX_NAME
        and all(_within(place, -NEAR, NEAR) for place in point[1:3])
        and _within(point[3], 0.0, 1.0)
    )
    if not good:
        raise AttentionError(
            f"seen.keypoints[{number}]: [name of 1 to {MAX_NAME} characters, x and y of {-NEAR:g} "
            f"to {NEAR:g}, confidence of 0 to 1]"
        )
    return Keypoint(*point)


def _text(head: Mapping[str, Any], name: str, most: int) -> None:
    if type(head[name]) is not str or len(head[name]) > most:
        raise AttentionError(f"seen.{name}: a text of at most {most} characters")


def _check_map(attention: np.ndarray) -> None:
    shape = attention.shape
    if attention.dtype != np.uint8 or len(shape) != 2 or not all(1 <= n <= MAX_SIDE for n in shape):
        raise AttentionError(
            f"attention: u1, 1 to {MAX_SIDE} rows and columns, not {attention.dtype} {list(shape)}"
        )


def _within(value: Any, low: float, high: float) -> bool:
    """Whether it is a number in the range; NaN and infinity are in none."""
    return type(value) in (int, float) and bool(low <= value <= high)
