"""Finishes the folder of a killed recorder, or of a machine that went down.

Such a folder has the suffix ``.partial``. Its rows and video fragments are complete up to the kill.
Broken ends are truncated, the manifest states why the episode is incomplete, and only then the
folder gets its final name. Nothing is copied, so a nearly full disk is enough. An interrupted
recovery can be repeated.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from surg_recording.clock.clock_steps import CLOCK_STEP
from surg_recording.episode import damaged, finishing, labels, manifest_check
from surg_recording.episode.annotations import Annotations, parse_tag
from surg_recording.episode.episode_reader import FORMAT, MANIFEST, PARTIAL
from surg_recording.episode.episode_writer import LOCK, RESERVE
from surg_recording.episode.table_columns import EVENTS
from surg_recording.episode.table_file import read_table
from surg_recording.file_io import read_json, sync_folder
from surg_recording.recording_errors import EpisodeError

REASON = "the recorder was killed; recovered at the next start"
_PHASES = ("stamp_ns", "phase", "done")
BY_HAND = "the recorder was killed; recovered by hand"


class HeldError(EpisodeError):
    """A folder that a running recorder or encoder is writing."""


def recover(
    parent: Path, name: str | None = None, on_problem: Callable[[str], None] | None = None
) -> list[Path]:
    """Finish the ``.partial`` folders in ``parent`` that no running recorder holds; returns them.

    Only episodes called ``name`` (and ``name_2``, …) if given. ``on_problem`` is called with a
    sentence per folder that cannot be repaired and stays as it is.
    """
    done: list[Path] = []
    for folder in unfinished(parent):
        final = folder.name.removesuffix(PARTIAL)
        if name is not None and final != name and not final.startswith(f"{name}_"):
            continue
        try:
            done.append(recover_one(folder))
        except HeldError:
            continue
        except EpisodeError as problem:
            if on_problem is not None:
                on_problem(str(problem))
    return done


def unfinished(parent: Path) -> list[Path]:
    """The ``.partial`` folders in a folder, by name."""
    return sorted(path for path in parent.glob(f"*{PARTIAL}") if path.is_dir())


def recover_one(folder: Path, reason: str = REASON) -> Path:
    """Finish one ``.partial`` folder and rename it; ``reason`` goes into the manifest.

    Raises:
        HeldError: A process is still writing it.
        EpisodeError: It is no such folder, or cannot be finished; it stays as it is.
    """
    if not folder.name.endswith(PARTIAL) or not folder.is_dir():
        raise EpisodeError(f"{folder}: no unfinished recording (a folder that ends in {PARTIAL})")
    final = folder.with_name(folder.name.removesuffix(PARTIAL))
    try:
        lock = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as problem:
        raise EpisodeError(f"{folder}: cannot be mended: {problem.strerror}") from problem
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise HeldError(f"{folder}: is being recorded now, or its encoder still runs") from None
        if final.exists():
            raise EpisodeError(f"{folder}: {final.name} is there already; move one of them away")
        if os.path.lexists(reserve := folder / RESERVE):
            damaged.cut(reserve, 0)  # space for the manifest; it holds zeros
            reserve.unlink()
        manifest, reasons = _manifest(folder)
        reasons += _unusable_labels(folder)
        manifest["recovered"] = finishing.utc_now()
        finishing.complete(folder, manifest, {}, "; ".join([reason, *reasons]))
        manifest.update(_recorded_annotations(folder, manifest.get("run")))
        finishing.write_json(folder / MANIFEST, manifest)
        damaged.set_aside(folder / LOCK)
        os.rename(folder, final)
        sync_folder(final.parent)
    except OSError as problem:
        raise EpisodeError(
            f"{folder}: cannot be mended: {problem.strerror}; it stays as it is"
        ) from problem
    finally:
        os.close(lock)
    return final


def _recorded_annotations(folder: Path, run: Any) -> dict[str, Any]:
    """Stages, tags, verdict and clock steps from the events, phases from the task's state.

    The numbers of rows before a clock step are lost.
    """
    annotations, last = Annotations(), 0
    steps: list[dict[str, int]] = []
    try:
        events = read_table(folder / "events.csv")
        for stamp, received, topic, by, text in zip(*map(events.__getitem__, EVENTS), strict=True):
            last = int(received)
            if topic == "/record/tag":
                last = int(stamp)
                annotations.add(parse_tag(text), last, by)
            elif topic == CLOCK_STEP:
                steps.append({"begin_ns": last, "step_ns": int(text.split()[-2])})
    except (EpisodeError, ValueError, IndexError):
        return {}
    with contextlib.suppress(EpisodeError):
        state = read_table(folder / "task_state.csv")
        for stamp, phase, done in zip(*map(state.__getitem__, _PHASES), strict=True):
            annotations.phase(str(phase), int(stamp), bool(done))
            last = max(last, int(stamp))
    annotations.end(last)
    return {
        "stages": annotations.stages(run),
        "tags": annotations.tags,
        "result": annotations.result,
        "segments": steps,
    }


def _unusable_labels(folder: Path) -> list[str]:
    """What is wrong with the labels; then they are set aside, and the rest can be read."""
    try:
        labels.read(folder)
    except EpisodeError as problem:
        kept = damaged.set_aside(folder / labels.LABELS)
        return [f"{labels.LABELS}: {problem}" + (f"; kept as {kept}" if kept else "")]
    return []


def _manifest(folder: Path) -> tuple[dict[str, Any], list[str]]:
    """The manifest written at the start, or what is known without one; and what is wrong with it.

    A manifest that cannot be used is set aside.
    """
    path, reasons = folder / MANIFEST, []
    try:
        manifest = read_json(path)
        if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
            raise EpisodeError(f"its format is not {FORMAT}")
        manifest_check.check(MANIFEST, {"tables": {}, "videos": {}, **manifest})
        return manifest, []
    except EpisodeError as problem:
        if os.path.lexists(path):
            reasons.append(f"{MANIFEST}: {problem}; kept as {damaged.set_aside(path)}")
        else:
            reasons.append(f"{MANIFEST} is missing")
    arms = sorted(path.stem.removeprefix("cycle_") for path in folder.glob("cycle_*.csv"))
    cameras = sorted({path.stem.partition(".")[0] for path in folder.glob("*.mp4")})
    known = {"format": FORMAT, "created": finishing.utc_now(), "arms": arms, "cameras": cameras}
    return known, reasons
