"""What `check-frames` saw, drawn: both eyes at rest, and where the tip went when it was told to."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

COLOURS = {"right": "#ffd400", "down": "#35d0ff", "away": "#7dff6a"}
ZOOM = 60.0
"""[px] Half width of what is shown of an eye's picture."""
OTHER = {"right": "left", "down": "up", "away": "nearer"}


def draw(folder: Path) -> Path | None:
    """Draw `check_frames.png` in a folder with results; None: no tip was seen at rest."""
    import matplotlib as mpl
    import numpy as np

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    result = json.loads((folder / "check_frames.json").read_text("utf-8"))
    file = folder / "check_frames.npz"
    if not file.is_file():
        return None
    with np.load(file, allow_pickle=False) as pictures:
        eyes = {
            eye: pictures[f"{eye}_rest"] for eye in ("left", "right") if f"{eye}_rest" in pictures
        }
    if not eyes or not result["places"]:
        return None
    figure, axes = plt.subplots(1, 1 + len(eyes), figsize=(4.2 * (1 + len(eyes)), 4.3))
    x, y = result["places"]["rest"]["left"]
    axes[0].imshow(eyes["left"])
    axes[0].add_patch(
        plt.Rectangle((x - ZOOM, y - ZOOM), 2 * ZOOM, 2 * ZOOM, fill=False, color="white", lw=1.5)
    )
    axes[0].set_title("left eye", fontsize=11)
    for axis, (eye, picture) in zip(axes[1:], eyes.items(), strict=True):
        axis.imshow(picture)
        axis.set_title(f"where the tip went, {eye} eye", fontsize=11)
        x, y = _place(result["places"], "rest", eye) or (x, y)
        axis.set_xlim(x - ZOOM, x + ZOOM)
        axis.set_ylim(y + ZOOM, y - ZOOM)
        _arrows(axis, result["places"], eye)
    for axis in axes:
        axis.set_axis_off()
    outcome = result["outcome"].replace("_", " ")
    figure.suptitle(f"told to go right, down and away: {outcome}", fontsize=13)
    figure.tight_layout()
    out = folder / "check_frames.png"
    figure.savefig(out, dpi=100)
    plt.close(figure)
    return out


def _arrows(axis: Any, places: dict[str, Any], eye: str) -> None:
    """An arrow from where the tip was on one side of an axis to where it was on the other."""
    for told, colour in COLOURS.items():
        start, end = (_place(places, step, eye) for step in (OTHER[told], told))
        if start is None or end is None:
            continue
        arrow = {"arrowstyle": "-|>", "color": colour, "lw": 2.5, "shrinkA": 0, "shrinkB": 0}
        axis.annotate("", xy=end, xytext=start, arrowprops=arrow)
        way = [e - s for s, e in zip(start, end, strict=True)]
        size = max((way[0] ** 2 + way[1] ** 2) ** 0.5, 1e-9)
        beyond = [e + 12.0 * w / size for e, w in zip(end, way, strict=True)]
        axis.text(*beyond, told, color=colour, fontsize=11, weight="bold", ha="center", va="center")


def _place(places: dict[str, Any], step: str, eye: str) -> tuple[float, float] | None:
    """Where the tip was in an eye's picture."""
    place = places.get(step)
    if place is None:
        return None
    x, y = place["left"]
    if eye == "left":
        return x, y
    if place["disparity"] is None:
        return None
    return x - place["disparity"][0], y - place["disparity"][1]
