"""The options of an export."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from surg_core import action_space
from surg_core.contract import ACTION_SPACES
from surg_recording.episode.selection import Selection, SelectionError
from surg_recording.job_pool import EXECUTORS

COPY = "copy"
VIDEO = ("encode", COPY)
SPLITS = ("train", "val", "test")
SPLIT_BY = ("order", "hash")


ANY_AGE_S = 3599.0
"""[s] Longer than any recording: no picture is too old."""


@dataclasses.dataclass(frozen=True)
class ExportOptions:
    """All choices; those under "what is exported" are part of a recording's input hash."""

    # What is exported.
    fps: int = 20
    cameras: tuple[str, ...] | None = None
    """Cameras to take; None: all of the first recording."""
    size: tuple[int, int] | None = None
    """Width and height that pictures are scaled to [px]; None: as recorded."""
    max_image_age_s: float = 0.1
    """Largest age of a picture at its grid time [s]; `ANY_AGE_S`: each is taken."""
    max_gap_s: float = 0.05
    """Kinematic samples further apart are not bridged [s]."""
    drop: tuple[str, ...] = ()
    columns: tuple[str, ...] | None = None
    """Features to keep beside action, instruction and tool, with ``*``; None: all but ``drop``.

    Recordings may then differ in task, robot and instrument, if these features are the same in all.
    """
    action_space: str = action_space.ABSOLUTE
    """How actions are expressed: a key of ``surg_core.contract.ACTION_SPACES``."""
    instruction: str | None = None
    """Instruction in words; None: the recording's own, or its task's name."""
    video: str = VIDEO[0]
    """``copy``: do not encode a recorded video a second time where it can be taken as it is."""
    crf: int = 18
    """Constant quality of x264, 0 to 51, smaller is better."""
    gop: int = 2
    """Distance of key frames: small, because training reads frames in random order."""
    preset: str = "veryfast"
    allow_incomplete: bool = False
    """Take recordings whose outcome is not ``complete``."""
    allow_unsynchronised: bool = False

    # How it is put together.
    splits: Mapping[str, float] = dataclasses.field(
        default_factory=lambda: {"train": 0.8, "val": 0.1, "test": 0.1}
    )
    """Shares of the recordings that are neither failures nor recoveries."""
    split_by: str = SPLIT_BY[0]
    """``order``: exact shares; ``hash``: a recording keeps its split in every export."""
    where: str | None = None
    """Which recordings to take (``episode.selection``); None: all."""
    about: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """Facts that only people know, for the dataset's page (``readme.KNOWN``)."""

    # How it is computed.
    executor: str = "process"
    workers: int | None = None
    """Number of processes; None: one per processor."""
    scheduler: str | None = None
    """Address of a Dask scheduler; None: a cluster of its own."""
    shard: tuple[int, int] | None = None
    """(i, n): only every n-th recording, from the i-th on, and no assembling (i from 0)."""
    keep_parts: bool = False
    """Keep the parts, so that a later export with more recordings is quick."""
    replace: bool = False

    def __post_init__(self) -> None:
        """Check the options; a ValueError names the option, its value and what is allowed."""
        _need(isinstance(self.fps, int) and 1 <= self.fps <= 1000, "fps", self.fps, "1 to 1000")
        known = self.action_space in ACTION_SPACES
        _need(known, "action-space", self.action_space, ", ".join(ACTION_SPACES))
        _need(self.video in VIDEO, "video", self.video, ", ".join(VIDEO))
        _need(0 <= self.crf <= 51, "crf", self.crf, "0 to 51")
        _need(1 <= self.gop <= 1000, "gop", self.gop, "1 to 1000")
        _need(0 < self.max_image_age_s < 3600, "max-image-age", self.max_image_age_s, "over 0 s")
        _need(0 < self.max_gap_s < 3600, "max-gap", self.max_gap_s, "over 0 s")
        _need(self.executor in EXECUTORS, "executor", self.executor, ", ".join(EXECUTORS))
        _need(self.workers is None or self.workers >= 1, "workers", self.workers, "1 or more")
        if self.size is not None:
            even = all(2 <= n <= 8192 and n % 2 == 0 for n in self.size)
            _need(even, "size", self.size, "even numbers of pixels, 2 to 8192")
        if self.shard is not None:
            i, n = self.shard
            _need(n >= 1 and 0 <= i < n, "shard", f"{i}/{n}", "i/n with 0 ≤ i < n")
        shares = dict(self.splits)
        good = set(shares) <= set(SPLITS) and all(0 <= share <= 1 for share in shares.values())
        good = good and abs(sum(shares.values()) - 1.0) < 1e-9
        _need(good, "splits", shares, f"shares of {', '.join(SPLITS)} that add up to 1")
        _need(self.split_by in SPLIT_BY, "split-by", self.split_by, ", ".join(SPLIT_BY))
        if self.where is not None:
            try:
                Selection(self.where)
            except SelectionError as problem:
                raise ValueError(f"where: {problem}") from None
        dask = self.scheduler is None or self.executor == "dask"
        _need(dask, "scheduler", self.scheduler, "only with the executor dask")

    def content(self) -> dict[str, Any]:
        """The choices that change what a recording becomes, for its input hash."""
        kept = {} if self.columns is None else {"columns": sorted(self.columns)}
        own = {name: getattr(self, name) for name in _CONTENT}
        return {**own, **kept, "drop": sorted(self.drop)}


_CONTENT = (
    *("fps", "cameras", "size", "max_image_age_s", "max_gap_s", "drop", "instruction"),
    *("action_space", "video", "crf", "gop", "preset", "allow_incomplete", "allow_unsynchronised"),
)


def _need(condition: bool, name: str, value: object, allowed: str) -> None:
    if not condition:
        raise ValueError(f"{name}: {value!r} is not allowed; allowed: {allowed}")
