"""Corrupted recordings in every command: an error or a right result, no trace, no hang, no loss."""

from __future__ import annotations

import contextlib
import dataclasses
import gc
import io
import json
import multiprocessing
import os
import shutil
import stat
import time
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import pytest

from helpers.recording import datasets_synthetic
from helpers.recording.corruptions import ALL, CAMERA, Corruption
from helpers.results.corruption_results import COMMANDS, note
from surg_cli import __main__ as cli
from surg_cli.host.terminal import CliError
from surg_recording import datasets
from surg_recording.episode import episode_reader
from surg_recording.reports import episode_view, evaluation

LIMIT_S = 10.0
LOADED = episode_view
"""The children need not load it once more."""


@dataclasses.dataclass(frozen=True)
class Place:
    """An intact recording, another one, and what they come to."""

    whole: Path
    other: Path
    entry: dict[str, Any]
    frames: int
    frames_of_other: int


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Place:
    root = tmp_path_factory.mktemp("recordings")
    whole = datasets_synthetic.record(root / "whole", 1, 1.0, (CAMERA,), size=(96, 64), felt=True)
    other = datasets_synthetic.record(root / "other", 2, 0.4, (CAMERA,), size=(96, 64), felt=True)
    entries, _ = evaluation.measure_all([whole], None, False, lambda part, text: None)
    frames = [frames_of([folder])[0] for folder in (whole, other)]
    return Place(whole, other, without_folder(entries[0]), *frames)


def without_folder(entry: dict[str, Any]) -> dict[str, Any]:
    return json.loads(json.dumps({k: v for k, v in entry.items() if k != "folder"}))


def frames_of(folders: list[Path]) -> tuple[int, dict[str, str]]:
    """Frames of an export, and what it refuses."""
    options = datasets.ExportOptions(executor="serial")
    exporter = datasets.load("robomimic")
    report = datasets.dry_run(exporter, folders, options, lambda part, text: None)
    return report.frames, report.refused


# --- the commands -------------------------------------------------------------------------------


def view(folder: Path, place: Place) -> str:
    """The error, or what the page says is missing or changed; empty: all is well."""
    out = folder.parent / "page.html"
    code = cli.run(["episode", "view", str(folder), "--out", str(out)])
    assert code == 0
    page = out.read_text("utf-8")
    assert "<script" in page
    notes = page.partition('<ul class="notes">')[2].partition("</ul>")[0]
    return notes.replace("<li>", "").replace("</li>", "; ")


def evaluate(folder: Path, place: Place) -> str:
    """Why it was left out; empty: its entry is that of the intact recording."""
    quiet: Callable[[float, str], None] = lambda part, text: None  # noqa: E731
    entries, left_out = evaluation.measure_all([folder, place.other], None, False, quiet)
    assert entries[-1]["folder"] == str(place.other), "one bad recording costs only itself"
    if left_out:
        assert len(entries) == 1
        return left_out[0].reason
    assert without_folder(entries[0]) == place.entry
    return ""


def export(folder: Path, place: Place) -> str:
    """Why it was refused; empty: its frames are those of the intact recording."""
    frames, refused = frames_of([folder, place.other])
    assert str(place.other) not in refused, "one bad recording costs only itself"
    if refused:
        (reason,) = refused.values()
        return reason
    assert frames == place.frames + place.frames_of_other
    return ""


def recover(folder: Path, place: Place) -> str:
    """The reason in the recovered manifest, or the error."""
    partial = folder.rename(folder.with_name("episode.partial"))
    words = io.StringIO()
    with contextlib.redirect_stderr(words):
        code = cli.run(["episode", "recover", str(partial)])
    if code:
        assert partial.is_dir()
        return words.getvalue()
    return str(episode_reader.read(partial.with_name("episode")).manifest["reason"])


def in_child(answer: Connection, command: str, folder: Path, place: Place) -> None:
    """Run one command and send its result: its words, and a trace if there is one."""
    os.environ[cli.READY] = "1"
    said, trace = "", ""
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            said = {"view": view, "evaluate": evaluate, "export": export, "recover": recover}[
                command
            ](folder, place)
    except (CliError, datasets.ExportError) as problem:
        said = str(problem)
    except BaseException:
        trace = traceback.format_exc()
    answer.send((said, trace))
    answer.close()
    os._exit(0)


def run(command: str, folder: Path, place: Place) -> tuple[str, str, float]:
    """Words, trace and seconds of a command in a process of its own."""
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe(duplex=False)
    child = context.Process(target=in_child, args=(theirs, command, folder, place))
    begun = time.monotonic()
    # A video that another test has left to the garbage waits for threads that the child has not.
    gc.freeze()
    child.start()
    gc.unfreeze()
    theirs.close()
    try:
        said, trace = ours.recv() if ours.poll(LIMIT_S) else ("", f"hangs after {LIMIT_S} s")
    except EOFError:
        said, trace = "", "the process died"
    took = time.monotonic() - begun
    child.kill()
    child.join()
    return said, trace, took


# --- what must not be lost ----------------------------------------------------------------------


def content(folder: Path) -> dict[str, bytes]:
    """Everything in a folder: the bytes of files, the kind of anything else."""
    found = {}
    for path in folder.rglob("*"):
        mode = path.lstat().st_mode
        kind = str(stat.S_IFMT(mode)).encode()
        found[str(path.relative_to(folder))] = path.read_bytes() if stat.S_ISREG(mode) else kind
    return found


def lost(before: dict[str, bytes], after: dict[str, bytes]) -> list[str]:
    """Names of what was there before and is not now: neither in its place nor set aside."""
    return [name for name, data in before.items() if data and not _kept(name, data, after)]


def _kept(name: str, data: bytes, after: dict[str, bytes]) -> bool:
    now, aside = after.get(name, b""), after.get(f"{name}.damaged", b"")
    if data in (now, aside, now + aside) or (now + aside).rstrip(b"\0") == data.rstrip(b"\0"):
        return True
    return name == "manifest.json" and _is_supplemented(data, now)


def _is_supplemented(data: bytes, now: bytes) -> bool:
    """Whether a manifest has only gained what a report or a recovery states."""
    try:
        old, new = json.loads(data), json.loads(now)
    except (ValueError, RecursionError):
        return False
    stated = {"sync", "tables", "videos", "outcome", "reason", "finished", "recovered", "topics"}
    stated |= {"stages", "tags", "result", "segments"}
    return all(new.get(key) == value for key, value in old.items() if key not in stated)


# --- the table ----------------------------------------------------------------------------------

LETTERS = {"view": "v", "evaluate": "e", "export": "x"}


def cell(corruption: Corruption, command: str, place: Place, folder: Path) -> tuple[str, float]:
    """What a command makes of a corruption: ``error``, ``right`` or ``recovered``; and seconds."""
    shutil.copytree(place.whole, folder)
    corruption.apply(folder)
    before = content(folder)
    said, trace, took = run(command, folder, place)
    where = f"{corruption.name}, {command}: {said}"
    assert not trace, f"{where}\n{trace}"
    after = next(
        content(path)
        for path in (folder, folder.with_name("episode.partial"))
        if os.path.lexists(path)
    )
    assert lost(before, after) == [], where
    if command == "recover":
        return ("recovered" if (folder / "manifest.json").exists() else "error"), took
    assert (LETTERS[command] in corruption.noticed) == bool(said), where
    assert not said or command == "view" or str(folder) in said, f"names no folder: {where}"
    return ("error" if said else "right"), took


@pytest.mark.parametrize(
    "corruption", [c for c in ALL if c.common], ids=lambda corruption: corruption.name
)
def test_an_error_or_a_right_result(corruption: Corruption, place: Place, tmp_path: Path) -> None:
    for command in COMMANDS:
        cell(corruption, command, place, tmp_path / command / "episode")


@pytest.mark.full
def test_the_whole_table(place: Place, tmp_path: Path) -> None:
    longest, wrong, found = 0.0, [], {}
    for number, corruption in enumerate(ALL):
        found[corruption.name] = outcomes = {}
        for command in COMMANDS:
            folder = tmp_path / str(number) / command / "episode"
            try:
                result, took = cell(corruption, command, place, folder)
            except AssertionError as problem:
                wrong.append(str(problem))
                continue
            outcomes[command] = result
            longest = max(longest, took)
    print(*wrong, sep="\n")
    assert wrong == []
    assert len({corruption.name for corruption in ALL}) == len(ALL) >= 60
    note(found, longest)


def test_an_intact_recording_is_right_everywhere(place: Place, tmp_path: Path) -> None:
    intact = Corruption("none", lambda folder: None, "")
    found = [cell(intact, command, place, tmp_path / command / "episode") for command in COMMANDS]
    assert [result for result, _ in found] == ["right", "right", "right", "recovered"]
