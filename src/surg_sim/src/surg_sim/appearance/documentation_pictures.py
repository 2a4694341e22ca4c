"""The documentation's pictures, taken in episodes.

Run ``python -m surg_sim.appearance.documentation_pictures docs/pictures``.

Scripted senders act, one seed, no ROS. Bowel grasping and retraction: a stereo pair of each of its
four steps and the room at the end of the third. Needle driving and thread in hole: before the hole
and behind it. Then a sheet of all tasks, inside above outside.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image

from surg_core.contract import GRID, TICK
from surg_sim import tasks
from surg_sim.appearance import cell_picture
from surg_sim.appearance.drawing import look
from surg_sim.appearance.opengl import NoOpenGL
from surg_sim.arrays import Picture
from surg_sim.envs.cell_session import CellSession, Tick
from surg_sim.envs.episode_runner import run_episode
from surg_sim.physics import cell_files, endoscope_rig, scene
from surg_sim.physics.spec_parts import quaternion
from surg_sim.physics.world import World
from surg_sim.tasks import State, episode_seeds

STEPS = ("point", "grasp", "assist", "retract")
"""Of bowel grasping and retraction: the assistant points, the robot holds, both do, it is shown."""
SHEET = "tasks"
ROOM = "bgr_room"

_LOOK_AT, _NARROW = (-0.30, -0.05, 0.19), 31.0  # [m] patient axes, [deg]
_INSIDE, _OUTSIDE = (520, 390), (1200, 675)
_CELL = (376, 282)  # [px] of one picture of the sheet
_GAP = 8  # [px]
_BEFORE = 0.0045  # [m] of the needle's point or the thread's end before the hole


def stereo(world: World) -> Picture:
    """Both pictures of the endoscope side by side, the left one on the left."""
    views = (endoscope_rig.LEFT, endoscope_rig.RIGHT)
    return np.concatenate([cell_picture.take(world, view, *_INSIDE) for view in views], axis=1)


def room(world: World) -> Picture:
    """The spectator's picture, nearer to where the work is done."""
    with close_up(world):
        return cell_picture.take(world, scene.OVERVIEW, *_OUTSIDE)


@contextmanager
def close_up(world: World) -> Iterator[None]:
    """Point the spectator's camera at the patient and narrow its view."""
    model, site = world.model, scene.site_of([world.cell.arms[name] for name in world.arms])
    camera = model.camera(scene.OVERVIEW)
    before = camera.quat.copy(), camera.fovy.copy()
    sight = site.place(_LOOK_AT) - camera.pos
    camera.quat[:] = quaternion(look(sight, np.array([0.0, 0.0, 1.0])))
    camera.fovy[:] = _NARROW
    try:
        yield
    finally:
        camera.quat[:], camera.fovy[:] = before


def column(world: World) -> Picture:
    """What the endoscope and the spectator see, one above the other."""
    width, height = _CELL
    both = [
        cell_picture.take(world, view, width, height) for view in (scene.ENDOSCOPE, scene.OVERVIEW)
    ]
    gap = np.full((_GAP, width, 3), 255, dtype=np.uint8)
    return np.concatenate([both[0], gap, both[1]], axis=0)


Moment = Callable[[Tick], bool]
Take = Callable[[World], Picture]


def episode(
    task: str, wanted: Mapping[str, tuple[Moment, Take]], seed: int, setting: str = "phantom"
) -> dict[str, Picture]:
    """Run one episode and take a picture at the first moment of each kind.

    ``wanted`` says when, asked on every tick of the grid, and how, by name of the picture.

    Raises:
        ValueError: The episode fails, or a moment does not come.
    """
    session = CellSession(
        cell_files.find(tasks.load(task).home_cell), task, setting, seed, visuals=True
    )
    taken: dict[str, Picture] = {}

    def watch(tick: Tick) -> None:
        if tick.tick % GRID:
            return
        for name, (now, take) in wanted.items():
            if name not in taken and now(tick):
                taken[name] = take(session.world)

    report = run_episode(session, seed, watch=watch)
    missing = sorted(set(wanted) - set(taken))
    if not report.success or missing:
        raise ValueError(f"{task}, seed {seed}: {report.reason or missing}: take another --seed")
    return taken


def after(seconds: float, holds: Callable[[State, str], bool]) -> Moment:
    """The moment when something about ground truth and phase has been so for a while [s]."""
    count = 0

    def now(tick: Tick) -> bool:
        nonlocal count
        count = count + 1 if tick.state and holds(tick.state, tick.verdict.phase) else 0
        return count * GRID * TICK > seconds

    return now


def in_phase(name: str) -> Callable[[State, str], bool]:
    """Whether the task is in a phase."""
    return lambda state, phase: phase == name


def of_bgr(seed: int) -> dict[str, Picture]:
    """Each step of bowel grasping and retraction, and the room."""
    moments = {
        "point": after(0.0, in_phase("grasp")),  # it has been pointed, the robot sets out
        "grasp": after(0.3, in_phase("assist")),
        "assist": after(0.2, in_phase("retract")),
        "retract": after(1.5, in_phase("still")),
    }
    wanted = {f"bgr_{step}": (moments[step], stereo) for step in STEPS}
    return episode("bgr", {**wanted, ROOM: (after(0.2, in_phase("retract")), room)}, seed)


def inside(world: World) -> Picture:
    """What the left camera of the endoscope sees."""
    return cell_picture.take(world, scene.ENDOSCOPE, *_INSIDE)


def of_needle_driving(seed: int) -> dict[str, Picture]:
    """The needle's point before the hole, and behind it."""

    def before(state: State, phase: str) -> bool:
        way = np.asarray(state["holes"])[int(float(np.asarray(state["asked"])))] - state["point"]
        return float(np.linalg.norm(way)) < _BEFORE

    wanted = {
        "needle_place": (after(0.0, before), inside),
        "needle_hold": (after(0.3, in_phase("hold")), inside),
    }
    return episode("needle_driving", wanted, seed)


def of_thread_in_hole(seed: int) -> dict[str, Picture]:
    """The thread's end before the hole, and behind it."""

    def before(state: State, phase: str) -> bool:
        return float(np.linalg.norm(np.asarray(state["hole"]) - state["end"])) < _BEFORE

    wanted = {
        "thread_in_hole/place": (after(0.0, before), inside),
        "thread_in_hole/hold": (after(0.3, in_phase("hold")), inside),
    }
    return episode("thread_in_hole", wanted, seed)


def of_all_tasks(seed: int) -> Picture:
    """A column for each bundled task."""
    moments = {
        "bgr": after(1.0, in_phase("still")),
        "endoscope_guidance": after(8.0, in_phase("follow")),
        "needle_driving": after(0.3, in_phase("hold")),
        "pick_and_place": after(0.6, in_phase("carry")),
        "thread_in_hole": after(0.3, in_phase("hold")),
    }
    columns = [episode(task, {SHEET: (now, column)}, seed)[SHEET] for task, now in moments.items()]
    gap = np.full((columns[0].shape[0], _GAP, 3), 255, dtype=np.uint8)
    spaced = [part for one in columns for part in (gap, one)]
    return np.concatenate(spaced[1:], axis=1)


def main(words: list[str] | None = None) -> int:
    """Entry point; returns the exit code (2: nothing to be had, 1: no OpenGL)."""
    parser = argparse.ArgumentParser(
        prog="python -m surg_sim.appearance.documentation_pictures",
        description=(__doc__ or "").split("\n")[0],
    )
    parser.add_argument("out", type=Path, help="folder to write into")
    parser.add_argument("--seed", type=int, default=episode_seeds.TRAINING.start + 1)
    parser.add_argument(
        "--only", choices=("bgr", "needle", "thread", SHEET), help="leave the others out"
    )
    options = parser.parse_args(words)
    options.out.mkdir(parents=True, exist_ok=True)
    try:
        pictures: dict[str, Picture] = {}
        if options.only in (None, "bgr"):
            pictures |= of_bgr(options.seed)
        if options.only in (None, "needle"):
            pictures |= of_needle_driving(options.seed)
        if options.only in (None, "thread"):
            pictures |= of_thread_in_hole(options.seed)
        if options.only in (None, SHEET):
            pictures[SHEET] = of_all_tasks(options.seed)
    except (ValueError, NoOpenGL) as error:
        print(f"surg_sim.appearance.documentation_pictures: {error}", file=sys.stderr)
        return 1 if isinstance(error, NoOpenGL) else 2
    for name, content in pictures.items():
        file = options.out / f"{name}.png"
        file.parent.mkdir(exist_ok=True)
        Image.fromarray(content).save(file, optimize=True)
        print(f"{file}: {file.stat().st_size / 1000:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
