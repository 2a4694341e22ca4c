"""What `check-frames` saw, drawn: both eyes at rest, and where the tip went when it was told to."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

COLOURS = {"right": "#ffd400", "down": "#35d0ff", "away": "#7dff6a"}
OTHER = {"right": "left", "down": "up", "away": "nearer"}


def draw(folder: Path) -> Path | None:
    """Draw `check_frames.png` beside the verdict.

    Args:
        folder: With `check_frames.json` and `check_frames.npz`.

    Returns:
        The picture; None where the check got no pictures of the tip at rest.
    """
    import matplotlib as mpl
    import numpy as np

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    found = json.loads((folder / "check_frames.json").read_text("utf-8"))
    file = folder / "check_frames.npz"
    if not file.is_file():
        return None
    with np.load(file, allow_pickle=False) as pictures:
        eyes = {
            eye: pictures[f"{eye}_rest"] for eye in ("left", "right") if f"{eye}_rest" in pictures
        }
    if not eyes:
        return None
    figure, axes = plt.subplots(1, len(eyes), figsize=(5.6 * len(eyes), 4.9), squeeze=False)
    for axis, (eye, picture) in zip(axes[0], eyes.items(), strict=True):
        axis.imshow(picture)
        axis.set_title(f"{eye} eye", fontsize=11)
        axis.set_axis_off()
        _arrows(axis, found["places"], eye)
    figure.suptitle(
        f"{found['outcome'].replace('_', ' ')}: told where the arrows are named", fontsize=12
    )
    figure.tight_layout()
    out = folder / "check_frames.png"
    figure.savefig(out, dpi=100)
    plt.close(figure)
    return out


def _arrows(axis: Any, places: dict[str, Any], eye: str) -> None:
    """An arrow from where the tip was on one side of an axis to where it was on the other."""
    for told, colour in COLOURS.items():
        ends = [_place(places, step, eye) for step in (OTHER[told], told)]
        if None in ends:
            continue
        start, end = ends
        axis.annotate(
            told,
            xy=end,
            xytext=start,
            color=colour,
            fontsize=11,
            weight="bold",
            ha="center",
            va="center",
            arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 2},
        )


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
