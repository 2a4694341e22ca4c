"""One moment of an episode in several looks: ``python -m surg_sim.looks.look_sheet OUT.webp``.

To see what ranges of one's own do before anything is trained on them.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from PIL import Image

import surg_core
from surg_sim.arrays import Picture
from surg_sim.envs.cell_session import Session
from surg_sim.envs.episode_runner import run_episode
from surg_sim.looks.endoscope_renderer import EndoscopeRenderer
from surg_sim.looks.look_randomisation import LookRandomisation
from surg_sim.looks.opengl import NoOpenGL
from surg_sim.physics import cell_files
from surg_sim.tasks import load

SIZE = (600, 480)
"""Width and height that a look is rendered at; shown at half of it [px]."""
COLUMNS = 4


def sheet(looks: LookRandomisation, task: str, seed: int, count: int) -> Picture:
    """Left pictures of the end of the expert's episode, in the looks of this seed and the next."""
    session = Session(cell_files.find(load(task).home_cell), task, seed=seed, looks=True)
    run_episode(session, seed)
    renderer = EndoscopeRenderer(session.world, ("left",), *SIZE)
    width, height = SIZE[0] // 2, SIZE[1] // 2
    tiles = []
    for n in range(count):
        renderer.wear(looks.draw(seed + n))
        picture = renderer.render(session.world.data.qpos)["left"]
        blocks = picture.reshape(height, 2, width, 2, 3).mean(axis=(1, 3))
        tiles.append(blocks.round().astype(np.uint8))
    renderer.close()
    tiles += [np.zeros_like(tiles[0])] * (-count % COLUMNS)
    rows = [np.hstack(tiles[i : i + COLUMNS]) for i in range(0, len(tiles), COLUMNS)]
    return np.vstack(rows)


def main(words: list[str] | None = None) -> int:
    """Entry point; returns the exit code (2: broken ranges, 1: no OpenGL)."""
    parser = argparse.ArgumentParser(
        prog="python -m surg_sim.looks.look_sheet", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("out", type=Path, help="picture to write; its name ends in the format")
    parser.add_argument("--looks", type=Path, metavar="FILE", help="ranges (default: built in)")
    parser.add_argument("--task", default="bgr")
    parser.add_argument("--seed", type=int, default=0, help="of the episode and the first look")
    parser.add_argument("--count", type=int, default=2 * COLUMNS)
    options = parser.parse_args(words)
    try:
        ranges = (
            LookRandomisation() if options.looks is None else LookRandomisation.read(options.looks)
        )
        picture = sheet(ranges, options.task, options.seed, options.count)
    except (surg_core.ConfigError, ValueError, NoOpenGL) as error:
        print(f"surg_sim.looks.look_sheet: {error}", file=sys.stderr)
        return 1 if isinstance(error, NoOpenGL) else 2
    Image.fromarray(picture).save(options.out, quality=85)
    return 0


if __name__ == "__main__":
    sys.exit(main())
