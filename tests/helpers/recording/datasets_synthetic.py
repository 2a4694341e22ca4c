"""Recordings for the tests of datasets: a moving arm, and pictures that say which they are."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt

from helpers.recording import felt_forces
from helpers.recording import recording_synthetic as base
from helpers.recording.picture_identity import HEIGHT, WIDTH, Identity, draw
from helpers.recording.recording_synthetic import TICK_NS, Synthetic
from helpers.recording.restated import edit_field, restate
from surg_recording.episode.episode_recorder import Recording

CAMERAS = ("endoscope_left", "endoscope_right")
IMAGE_TICKS = 25
"""A picture every 50 ms."""
FRAME_NS = IMAGE_TICKS * TICK_NS
STAGES = {"reach": "Reach for the path.", "follow": "Follow the path to its end."}
"""Of the made-up task, in words; its first phase has none."""
PHASES = {0: "wait", 75: "reach", 200: "follow"}
"""First tick -> phase of the task's state."""


def record(
    folder: Path,
    recording: int,
    seconds: float = 2.0,
    cameras: tuple[str, ...] = CAMERAS,
    task: bool = True,
    success: bool = True,
    robot: str = "ur5e",
    jitter_ns: int = 0,
    stall: tuple[int, int] = (0, 0),
    size: tuple[int, int] = (WIDTH, HEIGHT),
    picture: Callable[..., npt.NDArray[np.uint8]] = draw,
    paced: bool = False,
    felt: bool = False,
    **run: Any,
) -> Path:
    """Record a made-up episode with a moving arm; 50 ticks at rest before and after the motion.

    Frame n of a camera has the stamp of tick 25 n (plus a seeded jitter) and shows n; frames n in
    ``range(*stall)`` are missing. ``paced``: wait for the writers at every picture, as a simulator
    in lock-step does; needed for long ones. ``felt``: forces of ``felt_forces`` are recorded.
    """
    what = Synthetic(seconds=seconds)
    rng = np.random.default_rng(recording)
    info = {"robot": robot, "task": "synthetic", "seed": recording, "operator": "nobody"}
    info.update(instruction="follow the path", stages=STAGES, setting="phantom", **run)
    cell = {"name": "made up", "arms": {"PSM1": _arm(robot)}}
    manifest = {**{k: info[k] for k in ("task", "operator", "seed")}, "run": info, "cell": cell}
    recorder = Recording(
        folder,
        mode="lockstep",
        arms=["PSM1"],
        cameras=list(cameras),
        manifest={**manifest, "clock": "simulator ticks", "versions": {"software": "test"}},
        min_free_bytes=0,
    )
    ticks = round(seconds / 0.002)
    for tick in range(1, ticks + 101):
        moving = 50 < tick <= 50 + ticks
        if moving:
            recorder.command("PSM1", "servo_cp", base.pose(what, tick), "/operator", tick)
        message = base.cycle(what, tick, 1 if moving else 0)
        message.accepted = max(0, min(tick - 50, ticks))
        recorder.cycle("PSM1", message, tick)
        recorder.ground_truth(base.ground_truth(what, tick), tick)
        if felt and tick % felt_forces.SAMPLE_TICKS == 0:
            for place in felt_forces.PLACES:
                recorder.force("PSM1", place, felt_forces.wrench(place, tick), tick)
        if task and tick % IMAGE_TICKS == 0:
            recorder.task_state(_task(tick, ticks + 100, success), tick)
        while paced and tick % IMAGE_TICKS == 0 and recorder.status()["backlog"]["rows"] > 2000:
            time.sleep(0.002)
        if tick % IMAGE_TICKS == 0:
            late = int(rng.integers(0, jitter_ns + 1)) if jitter_ns else 0
            for number, camera in enumerate(cameras):
                if tick // IMAGE_TICKS in range(*stall):
                    continue
                shown = picture(Identity(recording, number, tick // IMAGE_TICKS), *size)
                recorder.image(camera, _message(shown, tick * TICK_NS + late), tick)
    verdict = {"done": True, "success": success, "reason": ""}
    return recorder.close({"sim": {"tick": ticks + 100, "done": True, "task": verdict}})


def copy(source: Path, target: Path, **changes: Any) -> Path:
    """A recording once more with other keys in its manifest; with some it is another recording."""
    shutil.copytree(source, target)
    if changes:
        edit(target, **changes)
        edit_field(target / "command_PSM1.csv", 1, "source", f"/{target.name}".replace(",", ""))
        restate(target)
    return target


def shift_pictures(folder: Path, by_ns: int) -> None:
    """Stamp all pictures of a recording later, in every place, as a late clock would."""
    manifest = json.loads((folder / "manifest.json").read_text("utf-8"))
    for entry in manifest["videos"].values():
        path = folder / entry["sidecar"]
        lines = [line.split(",") for line in path.read_text("utf-8").splitlines()]
        for line in lines[1:]:
            line[1] = str(int(line[1]) + by_ns)
        path.write_text("".join(",".join(line) + "\n" for line in lines), "utf-8")
    restate(folder)


def edit(folder: Path, **changes: Any) -> None:
    """Change top-level keys of a manifest."""
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text("utf-8"))
    manifest.update(changes)
    path.write_text(json.dumps(manifest), "utf-8")


def _arm(robot: str) -> dict[str, Any]:
    return {"robot": {"name": robot}, "instrument": {"name": "grasper"}}


def _task(tick: int, last: int, success: bool) -> SimpleNamespace:
    over = tick + IMAGE_TICKS > last
    return SimpleNamespace(
        header=base.header(tick * TICK_NS),
        tick=tick,
        phase=next(name for begin, name in reversed(PHASES.items()) if tick >= begin),
        done=over,
        success=over and success,
        reward=float(over and success),
        reason="",
        names=["target[3]", "held"],
        values=[0.1 * tick, 0.2, 0.3, -1.0],
    )


def _message(picture: npt.NDArray[np.uint8], stamp_ns: int) -> SimpleNamespace:
    height, width = picture.shape[:2]
    return SimpleNamespace(
        header=base.header(stamp_ns),
        width=width,
        height=height,
        step=3 * width,
        encoding="rgb8",
        data=picture.tobytes(),
    )
