"""Ways in which a recording can be broken, and who has to notice each.

A corruption changes a folder. ``noticed`` holds a letter per command of `./surg episode` that must
say so: ``v`` the page of `view`, ``e`` `evaluate`, ``x`` `export`. The others must give the result
of the intact recording. `recover` must end with a readable recording or an error.
"""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from helpers.recording.restated import edit_field, restate

Break = Callable[[Path], Any]
CAMERA = "endoscope_left"


@dataclasses.dataclass(frozen=True)
class Corruption:
    """One way to break a recording."""

    name: str
    apply: Break
    noticed: str
    common: bool = False
    """Part of the normal tier of the tests."""


# --- files --------------------------------------------------------------------------------------


def missing(name: str) -> Break:
    """Without a file."""
    return lambda folder: (folder / name).unlink()


def written(name: str, data: bytes) -> Break:
    """Other content."""
    return lambda folder: (folder / name).write_bytes(data)


def replaced(name: str, make: Callable[[Path], Any]) -> Break:
    """Something else in the place of a file."""

    def apply(folder: Path) -> None:
        (folder / name).unlink(missing_ok=True)
        make(folder / name)

    return apply


def link(target: str) -> Callable[[Path], Any]:
    """A symbolic link; to its own name it is a loop."""
    return lambda path: path.symlink_to(target or path.name)


def lines(name: str, change: Callable[[list[str]], list[str]], again: bool = False) -> Break:
    """Other lines of a table; ``again``: the manifest is made to fit."""

    def apply(folder: Path) -> None:
        path = folder / name
        path.write_text("".join(change(path.read_text().splitlines(True))))
        if again:
            restate(folder)

    return apply


def field(name: str, line: int, column: str, value: str, again: bool = False) -> Break:
    """Another value in one field."""

    def apply(folder: Path) -> None:
        edit_field(folder / name, line, column, value)
        if again:
            restate(folder)

    return apply


def overwritten(name: str, place: Callable[[int], int], data: bytes) -> Break:
    """Some bytes replaced, at a place that depends on the size."""

    def apply(folder: Path) -> None:
        path = folder / name
        with open(path, "rb+") as file:
            file.seek(place(path.stat().st_size))
            file.write(data)

    return apply


def cut(name: str, share: float) -> Break:
    """The end is missing."""
    return lambda folder: os.truncate(folder / name, int((folder / name).stat().st_size * share))


def keys(**changes: Any) -> Break:
    """Other top-level keys of the manifest; ``...`` removes one."""

    def apply(folder: Path) -> None:
        path = folder / "manifest.json"
        manifest = {**json.loads(path.read_text()), **changes}
        kept = {key: value for key, value in manifest.items() if value is not ...}
        path.write_text(json.dumps(kept))

    return apply


def within(*path: str, value: Any = ...) -> Break:
    """Another value deep in the manifest; ``...`` removes it."""

    def apply(folder: Path) -> None:
        file = folder / "manifest.json"
        manifest = json.loads(file.read_text())
        place = manifest
        for key in path[:-1]:
            place = place[key]
        if value is ...:
            del place[path[-1]]
        else:
            place[path[-1]] = value
        file.write_text(json.dumps(manifest))

    return apply


def _swapped(rows: list[str]) -> list[str]:
    rows[200], rows[300] = rows[300], rows[200]
    return rows


def _swapped_forces(rows: list[str]) -> list[str]:
    rows[20], rows[30] = rows[30], rows[20]
    return rows


def _doubled(rows: list[str]) -> list[str]:
    return [*rows[:100], rows[99], *rows[100:]]


def _half(rows: list[str]) -> list[str]:
    return rows[: len(rows) // 2]


def _renamed(old: str, new: str) -> Callable[[list[str]], list[str]]:
    return lambda rows: [rows[0].replace(old, new, 1), *rows[1:]]


def _torn(rows: list[str]) -> list[str]:
    return [*rows[:-1], rows[-1][:40]]


def _of_windows(rows: list[str]) -> list[str]:
    return [row.replace("\n", "\r\n") for row in rows]


def _utf_16(folder: Path) -> None:
    path = folder / "cycle_PSM1.csv"
    path.write_bytes(path.read_text().encode("utf-16"))


MANIFEST, CYCLE = "manifest.json", "cycle_PSM1.csv"
TRUTH, COMMAND, EVENTS = "ground_truth_PSM1.csv", "command_PSM1.csv", "events.csv"
FORCE = "tip_force_PSM1.csv"
VIDEO, SIDECAR, SYNC = f"{CAMERA}.mp4", f"{CAMERA}.csv", "sync.json"
NESTED = b"[" * 200_000
FIFO, FOLDER, LOOP = os.mkfifo, Path.mkdir, link("")
FAR, BACK = str(2**63 - 1), str(-(2**63))
STEP = {"begin_ns": "x", "step_ns": [], "rows": 1}
LABELS = "labels.json"
MODEL = {"width": 96, "height": 64, "distortion_model": "plumb_bob", "D": [0.0] * 5,
         "K": [80.0, 0.0, 48.0, 0.0, 80.0, 32.0, 0.0, 0.0, 1.0], "R": [1.0, 0, 0, 0, 1, 0, 0, 0, 1],
         "P": [80.0, 0.0, 48.0, 0.0, 0.0, 80.0, 32.0, 0.0, 0.0, 0.0, 1.0, 0.0]}  # fmt: skip


def model(**changes: Any) -> Break:
    """A camera model with other entries."""
    return keys(camera_info={CAMERA: {**MODEL, **changes}})


def said(**entries: Any) -> Break:
    """Labels with other entries."""
    good = {"format": "surg_labels/1", "by": "A", "at": "2026-11-23T07:08:21Z"}
    empty = {"success": None, "note": "", "stages": None, "trim": None}
    return written(LABELS, json.dumps({**good, **empty, **entries}).encode())


ALL = (
    Corruption("manifest: missing", missing(MANIFEST), "vex"),
    Corruption("manifest: empty", written(MANIFEST, b""), "vex"),
    Corruption("manifest: torn", cut(MANIFEST, 0.5), "vex", True),
    Corruption("manifest: binary", written(MANIFEST, bytes(range(256)) * 40), "vex"),
    Corruption("manifest: a folder", replaced(MANIFEST, FOLDER), "vex"),
    Corruption("manifest: a named pipe", replaced(MANIFEST, FIFO), "vex", True),
    Corruption("manifest: a link to itself", replaced(MANIFEST, LOOP), "vex"),
    Corruption("manifest: a link to nothing", replaced(MANIFEST, link("none")), "vex"),
    Corruption("manifest: a device", replaced(MANIFEST, link("/dev/zero")), "vex"),
    Corruption("manifest: deeply nested", written(MANIFEST, NESTED), "vex", True),
    Corruption("manifest: a list", written(MANIFEST, b"[1, 2]"), "vex"),
    Corruption("manifest: without format", keys(format=...), "vex"),
    Corruption("manifest: of a newer format", keys(format="surg_episode/9"), "vex"),
    Corruption("manifest: format is a list", keys(format=[]), "vex"),
    Corruption("manifest: without tables", keys(tables=...), "vex"),
    Corruption("manifest: tables is a list", keys(tables=[1]), "vex"),
    Corruption("manifest: a table is a number", within("tables", "cycle_PSM1", value=7), "vex"),
    Corruption("manifest: rows is a text",
               within("tables", "cycle_PSM1", "rows", value="many"), "vex", True),
    Corruption("manifest: rows is missing", within("tables", "cycle_PSM1", "rows"), "x"),
    Corruption("manifest: rows beyond 64 bits",
               within("tables", "cycle_PSM1", "rows", value=10**30), "vex"),
    Corruption("manifest: columns is a number",
               within("tables", "cycle_PSM1", "columns", value=3), "vex"),
    Corruption("manifest: columns is missing", within("tables", "cycle_PSM1", "columns"), "x"),
    Corruption("manifest: a table outside the folder",
               within("tables", "../other", value={"rows": 1}), "vex"),
    Corruption("manifest: arms is a number", keys(arms=5), "vex"),
    Corruption("manifest: arms is a list of objects", keys(arms=[{}]), "vex"),
    Corruption("manifest: another arm", keys(arms=["PSM9"]), "vex"),
    Corruption("manifest: run is a list", keys(run=[]), "vex"),
    Corruption("manifest: setting is an object", within("run", "setting", value={}), "vex"),
    Corruption("manifest: sim is a text", keys(sim="yes"), "vex"),
    Corruption("manifest: the task's verdict is a list", within("sim", "task", value=[1]), "vex"),
    Corruption("manifest: result is a list", keys(result=[True]), "vex"),
    Corruption("manifest: success is a text", keys(result={"success": "yes"}), "vex"),
    Corruption("manifest: arms of the cell is a list", keys(cell={"arms": []}), "vex"),
    Corruption("manifest: stages is a text", keys(stages="all"), "vex"),
    Corruption("manifest: tags is a number", keys(tags=1), "vex"),
    Corruption("manifest: topics is a list", keys(topics=[]), "vex"),
    Corruption("manifest: segments is a text", keys(segments="two"), "vex"),
    Corruption("manifest: segments of wrong types",
               keys(mode="freerun", segments=[STEP]), "vex", True),
    Corruption("manifest: a video is null", within("videos", CAMERA, value=None), "vex"),
    Corruption("manifest: outcome is a number", keys(outcome=1), "vex"),
    Corruption("manifest: it was incomplete", keys(outcome="incomplete", reason="disk"), "ex"),
    Corruption("camera model: a good one", model(), ""),
    Corruption("camera model: a list of models", keys(camera_info=[MODEL]), "vex"),
    Corruption("camera model: a number", keys(camera_info={CAMERA: 7}), "x", True),
    Corruption("camera model: three numbers for K", model(K=[80.0, 48.0, 32.0]), "x"),
    Corruption("camera model: nulls in K", model(K=[None] * 9), "x"),
    Corruption("camera model: a text in P", model(P=["f"] * 12), "x"),
    Corruption("camera model: no width", model(width=0), "x"),
    Corruption("calibration: a file that is not as recorded",
               keys(cell={"files": {"calibration/endoscope_left.yaml": "0" * 64},
                          "calibration": {"calibration/endoscope_left.yaml": "K: 1"}}), "x"),
    Corruption("calibration: a chain of wrong types",
               within("cell", "endoscope", value={"arm": "PSM1", "X_FV": 1}), "x"),
    Corruption("labels: empty", written(LABELS, b""), "vex"),
    Corruption("labels: torn", written(LABELS, b'{"format": "surg_labels/1", "succ'), "vex"),
    Corruption("labels: a folder", replaced(LABELS, FOLDER), "vex"),
    Corruption("labels: a named pipe", replaced(LABELS, FIFO), "vex", True),
    Corruption("labels: a link to itself", replaced(LABELS, LOOP), "vex"),
    Corruption("labels: deeply nested", written(LABELS, NESTED), "vex"),
    Corruption("labels: success is a text", said(success="yes"), "vex"),
    Corruption("labels: a stage without a begin", said(stages=[{"name": "grasp"}]), "vex"),
    Corruption("labels: a trim of wrong types", said(trim={"begin_ns": "x", "end_ns": 1}), "vex"),
    Corruption("labels: a trim that leaves nothing", said(trim={"begin_ns": 5, "end_ns": 5}),
               "vex"),
    Corruption("sync.json: deeply nested", written(SYNC, NESTED), "x"),
    Corruption("sync.json: a named pipe", replaced(SYNC, FIFO), "x", True),
    Corruption("sync.json: of wrong types", written(SYNC, b'{"verdict": [], "reasons": 1}'), ""),
    Corruption("cycles: missing", missing(CYCLE), "vex"),
    Corruption("cycles: empty", written(CYCLE, b""), "vex"),
    Corruption("cycles: only the header", lines(CYCLE, lambda rows: rows[:1]), "vex"),
    Corruption("cycles: a folder", replaced(CYCLE, FOLDER), "vex"),
    Corruption("cycles: a named pipe", replaced(CYCLE, FIFO), "vex", True),
    Corruption("cycles: a link to itself", replaced(CYCLE, LOOP), "vex", True),
    Corruption("cycles: half of the rows", lines(CYCLE, _half), "vex"),
    Corruption("cycles: the last line torn", lines(CYCLE, _torn), "vex"),
    Corruption("cycles: two rows swapped", lines(CYCLE, _swapped), "vex"),
    Corruption("cycles: swapped, manifest fits", lines(CYCLE, _swapped, True), "ex"),
    Corruption("cycles: a row doubled", lines(CYCLE, _doubled), "vex"),
    Corruption("cycles: a joint edited", field(CYCLE, 200, "q0", "1.234"), "vex", True),
    Corruption("cycles: a NaN", field(CYCLE, 200, "p_tip_x", "nan", True), "ex"),
    Corruption("cycles: a value of 1e308", field(CYCLE, 200, "q0", "1e308", True), "ex", True),
    Corruption("cycles: a stamp of -2^63", field(CYCLE, 200, "stamp_ns", BACK, True), "ex"),
    Corruption("cycles: the first stamp is -2^63", field(CYCLE, 1, "stamp_ns", BACK, True), "ex"),
    Corruption("cycles: a stamp in 2262", field(CYCLE, 200, "stamp_ns", FAR, True), "ex"),
    Corruption("cycles: the last stamp is in 2262",
               field(CYCLE, 600, "stamp_ns", FAR, True), "ex"),
    Corruption("cycles: a stamp beyond 64 bits", field(CYCLE, 200, "stamp_ns", "9" * 40), "vex"),
    Corruption("cycles: a number of 5000 digits", field(CYCLE, 200, "tick", "1" * 5000), "vex"),
    Corruption("cycles: a word", field(CYCLE, 200, "q0", "abc"), "vex"),
    Corruption("cycles: no stamps", lines(CYCLE, _renamed("stamp_ns", "time")), "vex"),
    Corruption("cycles: a column twice", lines(CYCLE, _renamed("receive_ns", "stamp_ns")), "vex"),
    Corruption("cycles: binary", written(CYCLE, bytes(range(256)) * 40), "vex"),
    Corruption("cycles: zeros in the middle",
               overwritten(CYCLE, lambda size: size // 2, bytes(3000)), "vex", True),
    Corruption("cycles: a field of 200 kB", field(CYCLE, 200, "reason", "x" * 200_000), "vex"),
    Corruption("cycles: line ends of Windows", lines(CYCLE, _of_windows), "vex"),
    Corruption("cycles: UTF-16", _utf_16, "vex"),
    Corruption("truth: missing", missing(TRUTH), "vex"),
    Corruption("truth: half of the rows", lines(TRUTH, _half), "vex"),
    Corruption("truth: a NaN", field(TRUTH, 200, "tip_x", "nan", True), "ex"),
    Corruption("truth: a value of 1e308", field(TRUTH, 200, "force_x", "1e308", True), "ex"),
    Corruption("forces: missing", missing(FORCE), "vx", True),
    Corruption("forces: empty", written(FORCE, b""), "vx"),
    Corruption("forces: a folder", replaced(FORCE, FOLDER), "vx"),
    Corruption("forces: a named pipe", replaced(FORCE, FIFO), "vx", True),
    Corruption("forces: a link to itself", replaced(FORCE, LOOP), "vx"),
    Corruption("forces: half of the rows", lines(FORCE, _half), "vx"),
    Corruption("forces: swapped, manifest fits", lines(FORCE, _swapped_forces, True), "x"),
    Corruption("forces: a value edited", field(FORCE, 20, "force_x", "9.0"), "vx", True),
    Corruption("forces: a NaN", field(FORCE, 20, "force_x", "nan", True), "x"),
    Corruption("forces: a value of 1e308", field(FORCE, 20, "force_z", "1e308", True), "x"),
    Corruption("forces: known, without a force", field(FORCE, 20, "force_y", "", True), "x"),
    Corruption("forces: known is 7", field(FORCE, 20, "known", "7", True), "x"),
    Corruption("forces: a stamp of -2^63", field(FORCE, 20, "stamp_ns", BACK, True), "x"),
    Corruption("forces: a stamp in 2262", field(FORCE, 20, "stamp_ns", FAR, True), "x"),
    Corruption("forces: the last stamp is in 2262",
               field(FORCE, 85, "stamp_ns", FAR, True), "x"),
    Corruption("forces: a word", field(FORCE, 20, "force_x", "abc"), "vx"),
    Corruption("forces: no column for it", lines(FORCE, _renamed("force_x", "f")), "vx"),
    Corruption("commands: missing", missing(COMMAND), "ve"),
    Corruption("commands: a named pipe", replaced(COMMAND, FIFO), "ve"),
    Corruption("commands: a position edited", field(COMMAND, 50, "x", "0.5"), "ve"),
    Corruption("task: a folder", replaced("task_state.csv", FOLDER), "vx"),
    Corruption("task: a row missing", lines("task_state.csv", lambda rows: rows[:-1]), "vx"),
    Corruption("task: a value of 1e308",
               field("task_state.csv", 8, "task.held", "1e308", True), "x", True),
    Corruption("events: a link to itself", replaced(EVENTS, LOOP), "v"),
    Corruption("events: binary", written(EVENTS, bytes(range(256))), "v"),
    Corruption("video: missing", missing(VIDEO), "vx"),
    Corruption("video: empty", written(VIDEO, b""), "vx"),
    Corruption("video: a folder", replaced(VIDEO, FOLDER), "vx"),
    Corruption("video: a named pipe", replaced(VIDEO, FIFO), "vx", True),
    Corruption("video: no video", written(VIDEO, b"nothing" * 500), "vx"),
    Corruption("video: first four bytes", overwritten(VIDEO, lambda _: 0, b"\xff" * 4), "vx", True),
    Corruption("video: no description", overwritten(VIDEO, lambda _: 36, bytes(600)), "vx"),
    Corruption("video: cut", cut(VIDEO, 0.6), "vx"),
    Corruption("video: a byte in the middle",
               overwritten(VIDEO, lambda size: size // 2, b"\x55"), "vx"),
    Corruption("sidecar: missing", missing(SIDECAR), "vx"),
    Corruption("sidecar: a folder", replaced(SIDECAR, FOLDER), "vx"),
    Corruption("sidecar: a named pipe", replaced(SIDECAR, FIFO), "vx"),
    Corruption("sidecar: half of the lines", lines(SIDECAR, _half), "vx"),
    Corruption("sidecar: a stamp edited", field(SIDECAR, 9, "stamp_ns", "460000000"), "vx"),
)  # fmt: skip
