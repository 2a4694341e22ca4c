"""Reads what a metric needs of an arm: whole tables, cut and checked as an export reads them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from surg_core.contract import STREAMS
from surg_recording.clock.clock_segments import Segment
from surg_recording.episode import labels
from surg_recording.episode.checked.checked_reading import (
    checked_table,
    segment_of,
)
from surg_recording.episode.checked.long_table import check_cycle
from surg_recording.episode.episode_reader import Episode
from surg_recording.episode.table import Table
from surg_recording.recording_errors import EpisodeError

CYCLE_GAP_NS = 50_000_000
"""Longest time without a control cycle that a metric may bridge [ns]; as of an export."""


def for_metrics(recorded: Episode, arm: str) -> Episode:
    """The episode with the tables of an arm as an export reads them; only those are checked.

    Raises:
        EpisodeError: A table is not as recorded, or holds an impossible stamp or value; or the
            commanded window of a complete recording lacks control cycles.
    """
    segment, tables = segment_of(recorded), {}
    cycle = tables[f"cycle_{arm}"] = _finite_cycle(recorded, arm, segment)
    if recorded.complete:
        limit = recorded.bridged_ns(CYCLE_GAP_NS)
        _without_gap(recorded.folder / f"cycle_{arm}.csv", cycle, limit)
    truth = recorded.manifest["tables"].get(f"ground_truth_{arm}")
    if truth is not None and truth.get("rows") != 0:
        tables[f"ground_truth_{arm}"] = _finite_truth(recorded, arm, segment)
    command = f"command_{arm}"
    if command in recorded.tables:
        table = recorded.table(command)
        tables[command] = table if segment is None else segment.table(table, command)
    if labels.KEY in recorded.manifest:
        tables = {name: _trimmed(recorded, name, table) for name, table in tables.items()}
    return recorded.holding(tables)


def _trimmed(recorded: Episode, name: str, table: Table) -> Table:
    """The rows between the ends of the labels' trim; an EpisodeError if that leaves no cycle."""
    begin, end = labels.trim(recorded.manifest)
    stamps = table["stamp_ns"]
    kept = table.select((stamps >= begin) & (stamps <= end))
    if name.startswith("cycle_") and not len(kept):
        raise EpisodeError(f"{recorded.folder / labels.LABELS}: the trim leaves no row of {name}")
    return kept


def _finite_cycle(recorded: Episode, name: str, segment: Segment | None) -> Table:
    """An arm's control cycles, all measured values finite; else an EpisodeError."""
    cycle = checked_table(recorded, f"cycle_{name}", segment)
    check_cycle(recorded.folder / f"cycle_{name}.csv", cycle)
    return cycle


def _finite_truth(recorded: Episode, arm: str, segment: Segment | None) -> Table:
    """The simulator's ground truth of an arm, all values finite; else an EpisodeError."""
    name = f"ground_truth_{arm}"
    table = checked_table(recorded, name, segment)
    groups = ("shaft", "axis", "tip", "trocar", "trocar_loaded", "force")
    used = [f"{group}_{axis}" for group in groups for axis in "xyz"]
    table.require_finite(recorded.folder / f"{name}.csv", used)
    return table


def _without_gap(path: Path, cycle: Table, limit: int) -> None:
    """Refuse a commanded window with a long gap: a metric would bridge it by a straight line."""
    commanded = np.flatnonzero(np.isin(cycle["command"], STREAMS))
    if not len(commanded):
        return
    stamps = cycle["stamp_ns"][commanded[0] : commanded[-1] + 1]
    gaps = np.flatnonzero(np.diff(stamps) > limit)
    if len(gaps):
        row = int(gaps[0])
        raise EpisodeError(
            f"{path}: no control cycle for {(stamps[row + 1] - stamps[row]) * 1e-6:.0f} ms after"
            f" stamp_ns {stamps[row]}; at most {limit * 1e-6:.0f} ms can be bridged"
        )
