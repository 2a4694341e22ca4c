"""An animated picture of one episode: the room beside the endoscope's view.

Run ``python3 -m surg_sim.appearance.episode_animation docs/pictures/bgr_episode.webp``. Scripted
senders act in this process, without ROS. The result is an animated WebP that repeats forever.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from surg_core.contract import GRID, TICK
from surg_sim import tasks
from surg_sim.appearance import cell_picture
from surg_sim.appearance.documentation_pictures import close_up
from surg_sim.appearance.opengl import NoOpenGL
from surg_sim.arrays import Array, Picture
from surg_sim.envs.cell_session import CellSession, Tick
from surg_sim.envs.episode_runner import run_episode
from surg_sim.physics import cell_files, scene
from surg_sim.tasks import episode_seeds

FRAME_MS = 60
LAST_FRAME_MS = 1200
"""The result stays this long before the animation starts again."""
_ROOM, _ENDOSCOPE = (708, 472), (530, 472)  # [px]
_GAP = 8  # [px]
_QUALITY = 70  # of WebP, 0 to 100


def states_of(session: CellSession, seed: int, count: int) -> tuple[list[Array], float]:
    """Play an episode of a session built with visuals.

    Returns ``count`` joint positions (nq,) at equal distances in time, and the duration [s].

    Raises:
        ValueError: The episode fails.
    """
    seen: list[Array] = []

    def watch(tick: Tick) -> None:
        if tick.tick % GRID == 0 and tick.verdict.phase:
            seen.append(np.array(session.world.data.qpos))

    report = run_episode(session, seed, watch=watch)
    if not report.success:
        raise ValueError(f"seed {seed}: {report.reason}; choose another --seed")
    chosen = np.linspace(0, len(seen) - 1, count).round().astype(int)
    return [seen[i] for i in chosen], len(seen) * GRID * TICK


def frames_of(session: CellSession, states: list[Array]) -> list[Picture]:
    """The room on the left, the endoscope's left picture on the right."""
    with close_up(session.world):
        room = cell_picture.series(session.world, scene.OVERVIEW, *_ROOM, states)
    endoscope = cell_picture.series(session.world, scene.ENDOSCOPE, *_ENDOSCOPE, states)
    gap = np.zeros((_ROOM[1], _GAP, 3), dtype=np.uint8)
    return [np.concatenate([r, gap, e], axis=1) for r, e in zip(room, endoscope, strict=True)]


def write(frames: list[Picture], file: Path) -> None:
    """Write an animated WebP that repeats forever."""
    from PIL import Image

    pictures = [Image.fromarray(frame) for frame in frames]
    durations = [FRAME_MS] * (len(pictures) - 1) + [LAST_FRAME_MS]
    pictures[0].save(
        file,
        save_all=True,
        append_images=pictures[1:],
        duration=durations,
        loop=0,
        quality=_QUALITY,
        method=5,
    )


def main(words: list[str] | None = None) -> int:
    """Entry point; returns the exit code (2: the episode cannot be shown, 1: no OpenGL)."""
    parser = argparse.ArgumentParser(
        prog="python3 -m surg_sim.appearance.episode_animation",
        description=(__doc__ or "").split("\n")[0],
    )
    parser.add_argument("out", type=Path, help="WebP file to write")
    parser.add_argument("--task", default="bgr", help="bundled task (default bgr)")
    parser.add_argument("--seed", type=int, default=episode_seeds.TRAINING.start + 1)
    parser.add_argument("--seconds", type=float, default=8.0, help="length without the last frame")
    options = parser.parse_args(words)
    try:
        cell = cell_files.find(tasks.load(options.task).home_cell)
        session = CellSession(cell, options.task, seed=options.seed, visuals=True)
        count = round(1000 * options.seconds / FRAME_MS)
        states, duration = states_of(session, options.seed, count)
        frames = frames_of(session, states)
    except (ValueError, NoOpenGL) as error:
        print(f"surg_sim.appearance.episode_animation: {error}", file=sys.stderr)
        return 1 if isinstance(error, NoOpenGL) else 2
    write(frames, options.out)
    size, speed = options.out.stat().st_size / 1e6, duration / options.seconds
    print(f"{options.out}: {len(frames)} frames, {speed:.2f} times real time, {size:.2f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
