"""The printable parts fit the instrument that is drawn, guarded and driven."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import NDArray

import surg_core
from surg_cli.host import paths

DESCRIPTION = paths.ROOT / "src" / "surg_description"
PARTS = ("holder", "coupling")
MM = 1e-3
SLACK = 1e-4
"""[m] that a printed part may reach out of the guard's capsules."""
Array = NDArray[np.float64]


def stated(part: str) -> dict[str, float]:
    """Numbers of a part's source, as they stand."""
    text = (DESCRIPTION / "printed" / f"{part}.scad").read_text("utf-8")
    return {k: float(v) for k, v in re.findall(r"^(\w+) = ([\d.]+);", text, re.MULTILINE)}


def instrument() -> surg_core.InstrumentConfig:
    return surg_core.load_instrument(DESCRIPTION / "instruments" / "wristed_grasper.yaml")


def drawn() -> mujoco.MjModel:
    """The instrument's drawing."""
    urdf = (DESCRIPTION / "urdf" / "wristed_grasper.urdf").read_text("utf-8")
    return mujoco.MjSpec.from_string(urdf).compile()


def test_the_holder_is_the_one_of_the_drawing() -> None:
    says, model = stated("holder"), drawn()
    mount = surg_core.fixed_transform(DESCRIPTION / "urdf" / "wristed_grasper.urdf", "mount", "tip")
    assert says["offset"] * MM == pytest.approx(mount[0, 3], abs=1e-9)
    (shaft,) = (c for c in instrument().capsules if c.shaft)
    assert says["offset"] * MM == pytest.approx(shaft.a[0], abs=1e-9)
    geoms = {
        kind: [g for g in range(model.ngeom) if model.geom_bodyid[g] == model.body(kind).id]
        for kind in ("mount", "shaft")
    }
    plate, beam, tube, _ = (model.geom_size[g] for g in geoms["mount"])
    assert says["plate_radius"] * MM == pytest.approx(plate[0])
    assert says["plate"] * MM == pytest.approx(2 * plate[1])
    assert says["beam_at"] * MM == pytest.approx(model.geom_pos[geoms["mount"][1]][2] - beam[2])
    assert says["tube_radius"] * MM == pytest.approx(tube[0])
    assert says["tube"] * MM == pytest.approx(2 * tube[1])
    assert says["shaft"] * MM == pytest.approx(2 * model.geom_size[geoms["shaft"][0]][0])
    assert 0.0 < says["fit"] <= 0.4


def test_the_coupling_turns_the_joint_as_the_cells_drive_says() -> None:
    drive = paths.ROOT / "cells" / "emulated_ur5e_wrist" / "drive_PSM1.yaml"
    motors = yaml.safe_load(drive.read_text("utf-8"))["motors"]
    assert stated("coupling")["gear"] == motors["pitch"]["gear"] == motors["yaw"]["gear"]


def rendered(part: str, folder: Path, *words: str) -> tuple[Path, str]:
    """A part as OpenSCAD makes it, and what it said; without OpenSCAD the test is skipped."""
    if not shutil.which("openscad"):
        pytest.skip("missing: openscad (Debian package)")
    out = folder / f"{part}.stl"
    source = DESCRIPTION / "printed" / f"{part}.scad"
    argv = ["openscad", "-o", str(out), "--export-format", "binstl", *words, str(source)]
    done = subprocess.run(argv, capture_output=True, text=True, timeout=300)
    assert words or done.returncode == 0, done.stderr
    return out, done.stderr


def triangles(file: Path) -> Array:
    """Corners (n, 3, 3) [m] of a binary STL."""
    row = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("pad", "<u2")])
    found = np.frombuffer(file.read_bytes(), row, offset=84)
    return np.asarray(found["corners"], dtype=np.float64) * MM


@pytest.mark.oracle
@pytest.mark.untimed
def test_printed_parts_are_solid_and_lie_inside_the_guards_capsules(tmp_path: Path) -> None:
    files = {}
    for part in PARTS:
        files[part], said = rendered(part, tmp_path)
        assert re.search(r"Simple:\s+yes", said) and re.search(r"Volumes:\s+2\b", said), said
    holder = triangles(files["holder"])
    points = np.vstack([holder.reshape(-1, 3), holder.mean(axis=1)])
    off = np.full(len(points), np.inf)
    for c in instrument().capsules:
        a, along = np.asarray(c.a), np.asarray(c.b) - np.asarray(c.a)
        t = np.clip((points - a) @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
        away = np.linalg.norm(points - a - t[:, None] * along, axis=1) - c.radius
        off = np.minimum(off, away)
    assert off.max() < SLACK
    shaft = points[:, :2] - [stated("holder")["offset"] * MM, 0.0]
    bore = (stated("holder")["shaft"] + stated("holder")["fit"]) * MM / 2
    assert np.linalg.norm(shaft, axis=1).min() == pytest.approx(bore, abs=3e-5)
    _, said = rendered("coupling", tmp_path, "-D", "gear=3")
    assert "the drum is too thin" in said
    shoot(files, tmp_path)


def shoot(files: dict[str, Path], tmp_path: Path) -> None:
    """The parts as a picture: to look at, and for the guide."""
    figure = Figure(figsize=(9, 4), dpi=90)
    light = np.array([0.3, -0.5, 0.8]) / np.linalg.norm([0.3, -0.5, 0.8])
    offset, gear = stated("holder")["offset"], stated("coupling")["gear"]
    titles = (f"holder.scad: offset {offset:g} mm", f"coupling.scad: gear {gear:g}")
    for k, (title, file) in enumerate(zip(titles, files.values(), strict=True)):
        axes = figure.add_subplot(1, 2, k + 1, projection="3d", proj_type="ortho")
        faces = triangles(file) / MM
        normals = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-12)[:, None]
        shade = 0.55 + 0.45 * np.clip(normals @ light, 0.0, 1.0)
        colours = np.clip(shade[:, None] * [0.95, 0.65, 0.30], 0.0, 1.0)
        axes.add_collection3d(Poly3DCollection(faces, facecolors=colours, edgecolors="none"))
        low, high = faces.min(axis=(0, 1)), faces.max(axis=(0, 1))
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
        axes.set_box_aspect(high - low, zoom=1.2)
        axes.set(title=title, xticks=np.round([low[0], 0.0, high[0]], 1))
        axes.set(yticks=np.round([low[1], high[1]], 1), zticks=np.round([low[2], high[2]], 1))
        axes.view_init(elev=35, azim=-60)
    picture = Path(os.environ.get("SURG_PARTS_SHOT", tmp_path / "parts.png"))
    figure.savefig(picture)
    assert picture.stat().st_size > 10_000
