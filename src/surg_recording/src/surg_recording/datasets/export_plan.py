"""Which recordings an export takes, and why it refuses the others."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from surg_recording.datasets import inspection
from surg_recording.datasets.conversion import input_hash
from surg_recording.datasets.export_report import ExportError, Progress
from surg_recording.datasets.exporter import Exporter
from surg_recording.datasets.inspection import Candidate
from surg_recording.datasets.options import ExportOptions
from surg_recording.episode import episode_reader
from surg_recording.episode.same_recording import KnownRecordings
from surg_recording.episode.selection import Selection, SelectionError
from surg_recording.recording_errors import EpisodeError, words_of


@dataclasses.dataclass(frozen=True)
class ExportPlan:
    """The recordings to export, with their input hashes, and those refused."""

    candidates: tuple[Candidate, ...]
    keys: tuple[str, ...]
    refused: dict[str, str]
    unselected: int
    """Recordings that ``options.where`` leaves out."""


def make(
    exporter: Exporter, episodes: Sequence[Path], options: ExportOptions, progress: Progress
) -> ExportPlan:
    """Find the recordings and judge each by its manifest; an ExportError if there is none.

    The first good one decides what the export holds; those that hold something else are refused.
    """
    try:
        folders = episode_reader.find(episodes)
    except EpisodeError as problem:
        raise ExportError(f"{problem}; name folders of recordings") from None
    refused: dict[str, str] = {}
    candidates: list[Candidate] = []
    keys: list[str] = []
    known, unselected = KnownRecordings(), 0
    selection = None if options.where is None else Selection(options.where)
    for number, folder in enumerate(folders):
        progress(0.1 * number / len(folders), f"looking at {folder.name}")
        try:
            if selection is not None and not selection.matches(episode_reader.read(folder)):
                unselected += 1
                continue
            candidate = inspection.inspect(folder, options)
            alike = options.columns is not None or not candidates
            other = None if alike else candidates[0].layout.difference(candidate.layout)
            if other is not None:
                raise EpisodeError(
                    f"{folder}: {other}; export it with others of its kind, or"
                    " with the features that they share (--columns)"
                )
            key = input_hash(folder, candidate.layout, options, exporter)
            recorded = episode_reader.read(folder)
            if (twin := known.twin(recorded)) is not None:
                raise EpisodeError(f"{folder}: {twin}")
        except SelectionError as problem:
            raise ExportError(f"--where: {problem}") from None
        except Exception as problem:  # one recording, not the export
            refused[str(folder)] = words_of(problem, folder)
        else:
            known.add(recorded)
            keys.append(key)
            candidates.append(candidate)
    if unselected == len(folders):
        raise ExportError(f"--where {options.where!r}: none of {unselected} recordings fits")
    return ExportPlan(tuple(candidates), tuple(keys), refused, unselected)
