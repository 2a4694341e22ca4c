"""One moment in several appearances: ``python -m surg_sim.appearance.appearance_sheet OUT.webp``.

To see what ranges of one's own do before anything is trained on them.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from PIL import Image

import surg_core
from surg_sim.appearance.domain_randomization import DomainRandomization
from surg_sim.appearance.endoscope_renderer import EndoscopeRenderer
from surg_sim.appearance.opengl import NoOpenGL
from surg_sim.arrays import Picture
from surg_sim.envs.cell_session import CellSession
from surg_sim.envs.episode_runner import run_episode
from surg_sim.physics import cell_files
from surg_sim.tasks import load

SIZE = (600, 480)
"""Width and height that a look is rendered at; shown at half of it [px]."""
COLUMNS = 4


def sheet(randomization: DomainRandomization, task: str, seed: int, count: int) -> Picture:
    """Left pictures of the end of the expert's episode, as this seed and the next draw them."""
    session = CellSession(cell_files.find(load(task).home_cell), task, seed=seed, visuals=True)
    run_episode(session, seed)
    renderer = EndoscopeRenderer(session.world, ("left",), *SIZE)
    width, height = SIZE[0] // 2, SIZE[1] // 2
    tiles = []
    for n in range(count):
        renderer.set_appearance(randomization.draw(seed + n))
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
        prog="python -m surg_sim.appearance.appearance_sheet",
        description=(__doc__ or "").split("\n")[0],
    )
    parser.add_argument("out", type=Path, help="picture to write; its name ends in the format")
    parser.add_argument("--ranges", type=Path, metavar="FILE", help="ranges (default: built in)")
    parser.add_argument("--task", default="bgr")
    parser.add_argument("--seed", type=int, default=0, help="of the episode and the first look")
    parser.add_argument("--count", type=int, default=2 * COLUMNS)
    options = parser.parse_args(words)
    try:
        ranges = (
            DomainRandomization()
            if options.ranges is None
            else DomainRandomization.read(options.ranges)
        )
        picture = sheet(ranges, options.task, options.seed, options.count)
    except (surg_core.ConfigError, ValueError, NoOpenGL) as error:
        print(f"surg_sim.appearance.appearance_sheet: {error}", file=sys.stderr)
        return 1 if isinstance(error, NoOpenGL) else 2
    Image.fromarray(picture).save(options.out, quality=85)
    return 0


if __name__ == "__main__":
    sys.exit(main())
