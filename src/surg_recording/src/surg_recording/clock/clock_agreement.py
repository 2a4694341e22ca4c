"""Whether the machines' clocks agreed while an episode was recorded."""

from __future__ import annotations

from typing import Any

import numpy as np

from surg_recording.clock import clock_sync
from surg_recording.clock.verdict import CANNOT_TELL, FAIL, PASS
from surg_recording.episode.episode_reader import Episode
from surg_recording.episode.table import Table
from surg_recording.recording_errors import EpisodeError

CLOCK_TABLE = "clock_sync"
"""Table of the clock monitor's messages."""

SILENCE_BOUND = 5.0
"""Longest time between two samples of a clock [s]."""


def machines(manifest: Any) -> int:
    """Number of machines whose clocks stamped an episode, by its manifest.

    ``run.machines`` states it (a number, or a list of names). Otherwise a cell with an isolated
    network counts as two machines, any other cell as one.
    """
    stated = (manifest.get("run") or {}).get("machines")
    if isinstance(stated, list) and stated:
        return len(stated)
    if isinstance(stated, int) and stated > 0:
        return stated
    return 2 if (manifest.get("cell") or {}).get("network") == "isolated" else 1


def agreement(episode: Episode) -> dict[str, Any]:
    """Verdict on the machines' clocks: the key ``clock`` of ``sync.json``.

    Steps of the recorder's own clock are not judged here.
    """
    result: dict[str, Any] = {
        "verdict": PASS,
        "reasons": [],
        "machines": machines(episode.manifest),
        "samples": 0,
        **dict.fromkeys(("offset_s", "offset_median_s", "path_delay_s", "grandmaster")),
        "port_states": [],
    }
    if episode.manifest.get("mode") == "lockstep":
        return {**result, "reasons": ["lock-step: all stamps are the simulator's ticks"]}
    several = result["machines"] > 1
    if CLOCK_TABLE not in episode.tables:
        if several:
            return failed(result, "two machines, but no clock was monitored")
        return {**result, "reasons": ["one machine, one clock"]}
    try:
        table = episode.table(CLOCK_TABLE)
    except EpisodeError as problem:
        return {**result, "verdict": CANNOT_TELL, "reasons": [str(problem)]}
    result["samples"] = len(table)
    result["port_states"] = sorted(set(table["port_state"]) - {""})
    masters = sorted(set(table["grandmaster"]) - {""})
    result["grandmaster"] = masters[0] if len(masters) == 1 else (masters or None)
    followers = table["port_state"] != clock_sync.MASTER
    offset, delay = table["offset_s"][followers], table["path_delay_s"][followers]
    measured = np.isfinite(offset)
    if np.any(measured):
        offset = offset[measured]
        result["offset_s"] = float(offset[np.argmax(np.abs(offset))])
        result["offset_median_s"] = float(np.median(offset))
    if np.any(np.isfinite(delay)):
        result["path_delay_s"] = float(np.nanmedian(delay))
    faults = _clock_faults(table, several)
    if several and not np.any(followers):
        faults.append(
            "two machines, but only the master's clock was monitored; run the monitor on the other"
        )
    if several:
        silent = _longest_silence(episode, table)
        if silent > SILENCE_BOUND:
            faults.append(f"the clocks were not monitored for {silent:.0f} s")
    if several and len(masters) > 1:
        faults.append(f"the grandmaster changed: {', '.join(masters)}")
    return failed(result, *faults) if faults else result


def _clock_faults(table: Table, several: bool) -> list[str]:
    """One entry per kind of fault, with its count and its worst case.

    On one machine a missing master is harmless; an offset out of bounds is reported in any case.
    """
    worst: dict[str, tuple[int, float, str]] = {}
    for state, offset, delay, master, problem in zip(
        *(table[c] for c in ("port_state", "offset_s", "path_delay_s", "grandmaster", "problem")),
        strict=True,
    ):
        status = clock_sync.ClockStatus(state, offset, delay, master, "", problem)
        fault = status.fault()
        far = abs(offset) > clock_sync.OFFSET_BOUND
        if not fault or not (several or far):
            continue
        kind = "offset" if far else fault
        count, size, text = worst.get(kind, (0, -1.0, ""))
        size_now = abs(offset) if far else 0.0
        worst[kind] = (count + 1, max(size, size_now), fault if size_now > size else text)
    return [f"{text} ({count} of {len(table)} samples)" for count, _, text in worst.values()]


def _longest_silence(episode: Episode, table: Table) -> float:
    """Longest time without a sample of the clock, including the ends of the episode [s]."""
    times = np.sort(table["receive_ns"])
    start, stop = (episode.manifest.get(key) for key in ("started_ns", "stopped_ns"))
    ends = [int(t) for t in (start, stop) if isinstance(t, int)]
    return float(np.max(np.diff(np.sort(np.append(times, ends))), initial=0)) * 1e-9


def failed(result: dict[str, Any], *reasons: str) -> dict[str, Any]:
    """The result with the verdict ``fail`` and these reasons."""
    return {**result, "verdict": FAIL, "reasons": list(reasons)}
