"""A cell at home: ``python -m surg_sim.appearance.cell_picture OUT.png --view stereo``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

import surg_core
from surg_sim import tasks
from surg_sim.appearance.drawing import OUTSIDE
from surg_sim.appearance.opengl import NoOpenGL
from surg_sim.appearance.render import Renderer, show_only
from surg_sim.arrays import Array, Picture
from surg_sim.physics import endoscope_rig, scene
from surg_sim.physics.world import World


def take(world: World, camera: str, width: int, height: int) -> Picture:
    """One picture of the world as it is; see ``series``."""
    return series(world, camera, width, height, [np.array(world.data.qpos)])[0]


def series(
    world: World, camera: str, width: int, height: int, states: Sequence[Array]
) -> list[Picture]:
    """Pictures of states of the world, supersampled twice for smooth edges.

    The world is built with ``visuals=True``; a state is MuJoCo's joint positions (nq,); width and
    height in px.
    """
    inside = camera != scene.OVERVIEW
    show_only(world.model, lamps=not inside)
    limit = world.model.vis.global_
    factor = 2 if 2 * width <= limit.offwidth and 2 * height <= limit.offheight else 1
    renderer = Renderer(
        world.model,
        [camera],
        factor * width,
        factor * height,
        vignette=inside,
        hidden=[OUTSIDE] if inside else [],
        skins=world.task.skins if world.task is not None else (),
    )

    def small(qpos: Array) -> Picture:
        blocks = renderer.render(qpos)[0].reshape(height, factor, width, factor, 3)
        return np.asarray(blocks.mean(axis=(1, 3)).round(), dtype=np.uint8)

    try:
        return [small(qpos) for qpos in states]
    finally:
        renderer.close()


VIEWS = {
    "overview": ((scene.OVERVIEW, 853, 480),),
    "endoscope": ((scene.ENDOSCOPE, 640, 480),),
    "both": ((scene.OVERVIEW, 853, 480), (scene.ENDOSCOPE, 640, 480)),
    "stereo": ((endoscope_rig.LEFT, 640, 480), (endoscope_rig.RIGHT, 640, 480)),
}
"""What can be asked for: camera, width and height of each picture [px]."""


def main(arguments: list[str] | None = None) -> int:
    """Entry point; returns the exit code (2: broken configuration, 1: no OpenGL)."""
    parser = argparse.ArgumentParser(
        prog="python -m surg_sim.appearance.cell_picture", description=__doc__
    )
    parser.add_argument("out", type=Path, help="PNG file to write")
    parser.add_argument("--cell", default="cells/sim_ur5e", help="folder of the cell")
    parser.add_argument("--view", choices=sorted(VIEWS), default="both")
    parser.add_argument("--seed", type=int, default=0, help="seed of the tissue's look")
    parser.add_argument("--task", default="", help="show the beginning of this task's episode")
    options = parser.parse_args(arguments)
    try:
        world = World(
            surg_core.load_cell(options.cell),
            options.seed,
            visuals=True,
            task=tasks.load(options.task) if options.task else None,
        )
        pictures = [take(world, *view) for view in VIEWS[options.view]]
    except (surg_core.ConfigError, ValueError) as error:
        print(f"surg_sim.appearance.cell_picture: {error}", file=sys.stderr)
        return 2
    except NoOpenGL as error:
        print(f"surg_sim.appearance.cell_picture: {error}", file=sys.stderr)
        return 1
    Image.fromarray(np.concatenate(pictures, axis=1)).save(options.out, "PNG", optimize=True)
    print(options.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
