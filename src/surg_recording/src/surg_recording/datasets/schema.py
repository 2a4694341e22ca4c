"""The features of an exported frame, with names, units, frames and resampling method.

A feature is one column of numbers or one text, on the grid. Names of a policy's inputs and outputs
begin with ``observation`` or ``action``; ground truth that no robot can measure with
``privileged``; true stamps and ages with ``timing``. Only a picture's name contains "image":
lerobot takes such a column's statistics for those of a picture.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

from surg_core.contract import ACTION_KEY, FORCE_KEY, IMAGE_PREFIX, STATE_KEY, TASK_STATE_KEY

INSTRUCTION = "instruction.text"
STAGE = "instruction.stage"
TOOL = "observation.meta.tool"
CAMERA_POSE = "observation.camera_pose"
GROUND_TRUTH = "privileged.ground_truth"

ALWAYS = (INSTRUCTION, STAGE, TOOL)
"""Texts that every data set keeps: they say what a recording is."""

OPTIONAL = frozenset((FORCE_KEY, TASK_STATE_KEY, GROUND_TRUTH, CAMERA_POSE))
"""Features that a recording need not have."""

_ORDER = (
    STATE_KEY,
    ACTION_KEY,
    IMAGE_PREFIX,
    "observation.",
    "next.",
    "instruction.",
    TASK_STATE_KEY,
    "privileged.",
)


POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
POSE_UNITS = ("m", "m", "m", "1", "1", "1", "1")


@dataclasses.dataclass(frozen=True)
class Feature:
    """One column of a dataset."""

    name: str
    dtype: str
    """``float32``, ``float64``, ``int64``, ``bool``, ``string`` or ``video``."""
    shape: tuple[int, ...]
    """Shape of one frame: (D,), for a video (height, width, 3)."""
    names: tuple[str, ...]
    units: tuple[str, ...] = ()
    frame: str = ""
    """Reference frame of the vectors; empty where there is none."""
    method: str = ""
    """How it was resampled."""
    text: str = ""
    privileged: bool = False
    """Ground truth that no robot can measure."""
    camera: str = ""

    @property
    def rank(self) -> int:
        """Its order: state and action first, because lerobot takes the first that it finds."""
        ranks = [i for i, prefix in enumerate(_ORDER) if self.name.startswith(prefix)]
        return ranks[0] if ranks else len(_ORDER)

    @property
    def is_video(self) -> bool:
        """A camera's pictures."""
        return self.dtype == "video"

    def difference(self, other: Feature) -> str:
        """What ``other``, of the same name, has differently, in words; empty: nothing."""
        for field in dataclasses.fields(self):
            mine, theirs = getattr(self, field.name), getattr(other, field.name)
            if mine != theirs:
                return f"{self.name}: {field.name} {_words(theirs)}, not {_words(mine)}"
        return ""

    def describe(self) -> dict[str, Any]:
        """The feature for the JSON files of an export."""
        fields = dataclasses.asdict(self)
        return {key: list(v) if isinstance(v, tuple) else v for key, v in fields.items()}


def difference(mine: Sequence[Feature], theirs: Sequence[Feature]) -> str:
    """The first difference of a recording's features from those of another; empty: none."""
    own, others = ({feature.name: feature for feature in side} for side in (mine, theirs))
    for name in own.keys() | others.keys():
        if name not in others:
            return f"{name} is missing"
        if name not in own:
            return f"{name}: the others do not have it"
    return next(filter(None, (own[name].difference(others[name]) for name in own)), "")


def _words(value: object) -> str:
    return ", ".join(map(str, value)) if isinstance(value, tuple) else str(value)


def from_description(described: dict[str, Any]) -> Feature:
    """The feature from ``Feature.describe``."""
    lists = ("shape", "names", "units")
    return Feature(**{key: tuple(v) if key in lists else v for key, v in described.items()})


def columns_of(features: Sequence[Feature]) -> list[Feature]:
    """The features that are columns of tables: all but the videos."""
    return [feature for feature in features if not feature.is_video]


def videos_of(features: Sequence[Feature]) -> list[Feature]:
    """The features that are pictures."""
    return [feature for feature in features if feature.is_video]
