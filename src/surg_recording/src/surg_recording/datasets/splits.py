"""Divides recordings into the splits of a data set."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from surg_recording.datasets.dataset import Dataset, Part
from surg_recording.datasets.inspection import FAILURE, RECOVERY, SUCCESS
from surg_recording.datasets.layout import Layout
from surg_recording.datasets.options import SPLITS, ExportOptions


def arrange(name: str, parts: Sequence[Part], layout: Layout, options: ExportOptions) -> Dataset:
    """Order the recordings so that each split is one range: train, val, test, recovery, failure.

    The pieces of a long recording stay together.
    """
    plain = [part for part in parts if part.kind == SUCCESS]
    recordings = [list(pieces) for _, pieces in itertools.groupby(plain, lambda part: part.key)]
    divide = _by_hash if options.split_by == "hash" else _by_order
    groups = {
        name: [part for pieces in members for part in pieces]
        for name, members in divide(recordings, options).items()
    }
    for kind in (RECOVERY, FAILURE):
        groups[kind] = [part for part in parts if part.kind == kind]
    ordered: list[Part] = []
    splits = {}
    for split, members in groups.items():
        if members:
            splits[split] = (len(ordered), len(ordered) + len(members))
            ordered += members
    return Dataset(name, tuple(ordered), splits, layout, options)


Pieces = list[Part]
"""One recording: several parts if it is long."""


def _by_order(recordings: list[Pieces], options: ExportOptions) -> dict[str, list[Pieces]]:
    """Split → its recordings: the shares of the recordings in their order."""
    groups: dict[str, list[Pieces]] = {}
    begin, share = 0, 0.0
    for split in SPLITS:
        share += options.splits.get(split, 0.0)
        end = len(recordings) if share > 1.0 - 1e-9 else round(share * len(recordings))
        groups[split] = recordings[begin:end]
        begin = end
    return groups


def _by_hash(recordings: list[Pieces], options: ExportOptions) -> dict[str, list[Pieces]]:
    """Split → its recordings: each by its own hash, whatever else is exported."""
    groups: dict[str, list[Pieces]] = {split: [] for split in SPLITS}
    for pieces in recordings:
        place = int(str(pieces[0].about["identity"])[:13], 16) / 16**13
        share = 0.0
        for split in SPLITS:
            share += options.splits.get(split, 0.0)
            if place < share or share > 1.0 - 1e-9:
                groups[split].append(pieces)
                break
    return groups
