"""Recordings whose pictures carry their identity, so that a frame that is out of place is seen.

A picture is a row of black and white squares: a number of 24 bits with a parity row below it. It
says which recording it is of, which camera, and which frame; decoding survives H.264.
"""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt

from helpers import recording_synthetic as base
from helpers.recording_synthetic import TICK_NS, Synthetic
from surg_recording.recording import Recording

CAMERAS = ("endoscope_left", "endoscope_right")
WIDTH, HEIGHT = 96, 64
BITS, COLUMNS, ROWS = 24, 6, 4
IMAGE_TICKS = 25
"""A picture every 50 ms."""


@dataclasses.dataclass(frozen=True)
class Identity:
    """What a picture says."""

    recording: int
    camera: int
    frame: int

    def number(self) -> int:
        """As 24 bits: recording (8), camera (1), frame (15)."""
        return self.recording << 16 | self.camera << 15 | self.frame


def draw(identity: Identity, width: int = WIDTH, height: int = HEIGHT) -> npt.NDArray[np.uint8]:
    """The picture (height, width, 3): bits above, their complements below."""
    bits = np.array([identity.number() >> i & 1 for i in range(BITS)]).reshape(ROWS, COLUMNS)
    both = np.vstack([bits, 1 - bits])
    image = np.kron(both * 200 + 25, np.ones((height // (2 * ROWS), width // COLUMNS)))
    return np.repeat(image.astype(np.uint8)[..., None], 3, axis=2)


def read(image: npt.NDArray[Any]) -> Identity:
    """What a picture (height, width, 3) says.

    Raises:
        ValueError: it is no such picture, or two are mixed.
    """
    grey = np.asarray(image, dtype=float).mean(axis=2)
    high, wide = grey.shape[0] // (2 * ROWS), grey.shape[1] // COLUMNS
    grey = grey[: high * 2 * ROWS, : wide * COLUMNS]
    blocks = grey.reshape(2 * ROWS, high, COLUMNS, wide)
    # The middle of every square: its edges are what compression blurs.
    middle = blocks[:, high // 4 : max(high - high // 4, 1), :, wide // 4 : wide - wide // 4]
    ones = (middle.mean(axis=(1, 3)) > grey.mean()).astype(int)
    if not np.array_equal(ones[:ROWS], 1 - ones[ROWS:]):
        raise ValueError("no picture of ours, or a mixture of two")
    number = int(sum(int(bit) << i for i, bit in enumerate(ones[:ROWS].ravel())))
    return Identity(number >> 16, number >> 15 & 1, number & 0x7FFF)


def record(
    folder: Path,
    recording: int,
    seconds: float = 2.0,
    cameras: tuple[str, ...] = CAMERAS,
    task: bool = True,
    success: bool = True,
    robot: str = "ur5e",
    jitter_ns: int = 0,
    size: tuple[int, int] = (WIDTH, HEIGHT),
    **run: Any,
) -> Path:
    """Record a made-up episode with a moving arm; 50 ticks at rest before and after the motion.

    Frame n of a camera has the stamp of tick 25 n (plus a seeded jitter) and shows n.
    """
    what = Synthetic(seconds=seconds)
    rng = np.random.default_rng(recording)
    info = {"robot": robot, "task": "synthetic", "seed": recording, "operator": "nobody"}
    info.update(instruction="follow the path", setting="phantom", **run)
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
        if task and tick % IMAGE_TICKS == 0:
            recorder.task_state(_task(tick, ticks + 100, success), tick)
        if tick % IMAGE_TICKS == 0:
            late = int(rng.integers(0, jitter_ns + 1)) if jitter_ns else 0
            for number, camera in enumerate(cameras):
                picture = draw(Identity(recording, number, tick // IMAGE_TICKS), *size)
                recorder.image(camera, _message(picture, tick * TICK_NS + late), tick)
    verdict = {"done": True, "success": success, "reason": ""}
    return recorder.close({"sim": {"tick": ticks + 100, "done": True, "task": verdict}})


def copy(source: Path, target: Path, **changes: Any) -> Path:
    """A recording once more with other keys in its manifest."""
    shutil.copytree(source, target)
    edit(target, **changes)
    return target


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
        phase="move",
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
