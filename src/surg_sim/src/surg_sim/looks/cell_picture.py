"""Pictures of a cell at home: ``python -m surg_sim.looks.cell_picture OUT.png --view stereo``."""

from __future__ import annotations

import argparse
import struct
import sys
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from surg_sim import tasks
from surg_sim.looks.render import NoOpenGL, Picture, Renderer, show_only
from surg_sim.physics import endoscope_rig, scene
from surg_sim.physics.world import World

Array = NDArray[np.float64]


def png(picture: Picture) -> bytes:
    """An (h, w, 3) rgb8 picture as a PNG file."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        body = kind + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    height, width, _ = picture.shape
    # Filter 4, Paeth: less whichever of the pixels left, above and above left is the best guess.
    padded = np.pad(picture.astype(np.int16), ((1, 0), (1, 0), (0, 0)))
    left, above, corner = padded[1:, :-1], padded[:-1, 1:], padded[:-1, :-1]
    miss = [abs(above - corner), abs(left - corner), abs(left + above - 2 * corner)]
    guess = np.choose(np.argmin(miss, axis=0), [left, above, corner])
    rows = np.full((height, 1 + 3 * width), 4, dtype=np.uint8)
    rows[:, 1:] = (picture - guess).astype(np.uint8).reshape(height, -1)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
        + chunk(b"IDAT", zlib.compress(rows.tobytes(), 9))
        + chunk(b"IEND", b"")
    )


def take(world: World, camera: str, width: int, height: int) -> Picture:
    """One picture of the world as it is; see ``series``."""
    return series(world, camera, width, height, [np.array(world.data.qpos)])[0]


def series(
    world: World, camera: str, width: int, height: int, states: Sequence[Array]
) -> list[Picture]:
    """Pictures of states of the world, supersampled twice for smooth edges.

    Args:
        world: Built with ``looks=True``.
        camera: Name of the camera.
        width: Of each picture [px].
        height: Of each picture [px].
        states: MuJoCo joint positions (nq,), one per picture.
    """
    inside = camera != scene.OVERVIEW
    show_only(world.model, lamps=not inside)
    limit = world.model.vis.global_
    factor = 2 if 2 * width <= limit.offwidth and 2 * height <= limit.offheight else 1
    renderer = Renderer(
        world.model,
        camera,
        factor * width,
        factor * height,
        vignette=inside,
        hidden=[scene.OUTSIDE] if inside else [],
        skins=world.task.skins if world.task is not None else (),
    )

    def small(qpos: Array) -> Picture:
        blocks = renderer.render(qpos).reshape(height, factor, width, factor, 3).astype(np.float64)
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
    import surg_core

    parser = argparse.ArgumentParser(
        prog="python -m surg_sim.looks.cell_picture", description=__doc__
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
            looks=True,
            task=tasks.load(options.task) if options.task else None,
        )
        if options.view == "stereo" and endoscope_rig.RIGHT not in _cameras(world):
            raise ValueError(f"{options.cell}: its endoscope has one camera; --view endoscope")
        pictures = [take(world, *view) for view in VIEWS[options.view]]
    except (surg_core.ConfigError, ValueError) as error:
        print(f"surg_sim.looks.cell_picture: {error}", file=sys.stderr)
        return 2
    except NoOpenGL as error:
        print(f"surg_sim.looks.cell_picture: {error}", file=sys.stderr)
        return 1
    options.out.write_bytes(png(np.concatenate(pictures, axis=1)))
    print(options.out)
    return 0


def _cameras(world: World) -> set[str]:
    return {world.model.camera(i).name for i in range(world.model.ncam)}


if __name__ == "__main__":
    sys.exit(main())
