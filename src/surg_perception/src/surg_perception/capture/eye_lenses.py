"""The lens files of a cell for pictures of a given size."""

from __future__ import annotations

from pathlib import Path

from surg_core import ConfigError, lens_file

FRAMES = {"left": "endoscope_left", "right": "endoscope_right"}


def load(folder: Path | None, eyes: tuple[str, ...]) -> dict[str, lens_file.Lens]:
    """The measured lens of each eye; empty: nobody has measured them.

    Args:
        folder: ``calibration/`` of the cell; None: there is no cell.
        eyes: ``left``, or both.

    Raises:
        ConfigError: A file is broken, one of two is missing, or they make no stereo pair.
    """
    if folder is None:
        return {}
    files = {eye: folder / f"{FRAMES[eye]}.yaml" for eye in eyes}
    there = [eye for eye in eyes if files[eye].is_file()]
    if not there:
        return {}
    if len(there) < len(eyes):
        missing = next(files[eye] for eye in eyes if eye not in there)
        raise ConfigError(f"{missing}: is missing; measure both eyes: ./surg calibrate CELL stereo")
    lenses = {eye: lens_file.load_lens(files[eye]) for eye in eyes}
    if len(eyes) == 2:
        lens_file.check_eyes(
            lenses["left"], lenses["right"], str(files["left"]), str(files["right"])
        )
    return lenses


def fitted(
    lens: lens_file.Lens | None, width: int, height: int
) -> tuple[lens_file.Lens | None, str]:
    """The lens for a picture of this size; None with the reason where the aspect differs."""
    try:
        return (lens and lens.resized(width, height)), ""
    except ConfigError as error:
        return None, str(error)
