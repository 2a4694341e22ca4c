"""What the two HDF5 formats share: datasets that say what they hold, pictures frame by frame."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from surg_recording.datasets import pictures
from surg_recording.datasets.options import ExportOptions
from surg_recording.datasets.sampling import Sampled
from surg_recording.datasets.schema import Feature
from surg_recording.recording_errors import EpisodeError

NEEDS = {"h5py": "Debian: python3-h5py; pip install 'surg_recording[hdf5]'"}


def put(group: h5py.Group, name: str, values: npt.NDArray[Any], feature: Feature | None) -> None:
    """Write an array with names, units, frame and method as attributes."""
    if values.dtype == object:
        values = values.astype(h5py.string_dtype("utf-8"))
    made = group.create_dataset(name, data=values)
    if feature is not None:
        describe(made, feature)


def describe(target: h5py.Dataset, feature: Feature) -> None:
    """Attributes that say what an array holds."""
    target.attrs["feature"] = feature.name
    target.attrs["names"] = list(feature.names)
    target.attrs["units"] = list(feature.units)
    target.attrs["frame"] = feature.frame
    target.attrs["method"] = feature.method
    target.attrs["description"] = feature.text
    target.attrs["privileged"] = feature.privileged


def put_pictures(
    group: h5py.Group, name: str, sampled: Sampled, feature: Feature, options: ExportOptions
) -> None:
    """Write a camera's pictures as (N, height, width, 3) uint8 RGB, one chunk per frame.

    Compressed by LZF, which every h5py can read.

    Raises:
        EpisodeError: frames are missing, or of another size.
    """
    n, shape = sampled.grid.frames, tuple(feature.shape)
    made = group.create_dataset(
        name, (n, *shape), np.uint8, chunks=(1, *shape), compression="lzf", shuffle=False
    )
    describe(made, feature)
    done = 0
    for frame in sampled.frames(feature.name):
        image = pictures.rgb(frame, options.size)
        if image.shape != shape:
            raise EpisodeError(f"{feature.name}: a frame of {image.shape}, the first had {shape}")
        made[done] = image
        done += 1
    if done != n:
        raise EpisodeError(f"{feature.name}: {done} frames, the grid has {n}")


def check_pictures(
    stored: h5py.Dataset, sampled: Sampled, feature: Feature, options: ExportOptions
) -> None:
    """Compare stored pictures with the recording's, pixel by pixel.

    Raises:
        EpisodeError: they differ.
    """
    for number, frame in enumerate(sampled.frames(feature.name)):
        if not np.array_equal(stored[number], pictures.rgb(frame, options.size)):
            raise EpisodeError(f"{stored.file.filename}: {stored.name}: frame {number} differs")


def check_array(stored: h5py.Dataset, values: npt.NDArray[Any]) -> None:
    """Compare a stored array with what was meant.

    Raises:
        EpisodeError: they differ.
    """
    found = stored.asstr()[()] if h5py.check_string_dtype(stored.dtype) else stored[()]
    if not np.array_equal(found, values):
        raise EpisodeError(f"{stored.file.filename}: {stored.name}: read back something else")


def same_length(path: Path, arrays: Sequence[h5py.Dataset], length: int) -> list[str]:
    """What is wrong with the lengths of arrays, in words."""
    return [
        f"{path.name}: {array.name} has {array.shape[0]} rows, not {length}"
        for array in arrays
        if array.shape[0] != length
    ]
