"""What the two HDF5 formats share: described arrays, and pictures frame by frame."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from surg_recording.calibration import calibration_record
from surg_recording.datasets.formats.frame_arrays import check_frames, put_frames
from surg_recording.datasets.frames.sampling import Sampled
from surg_recording.datasets.options import ExportOptions
from surg_recording.datasets.schema import Feature
from surg_recording.recording_errors import EpisodeError

NEEDS = {"h5py": "Debian: python3-h5py; pip install 'surg_recording[hdf5]'"}


Places = Mapping[str, Feature]
"""Path in a group → the feature that is stored there."""


def put_all(group: h5py.Group, places: Places, sampled: Sampled, options: ExportOptions) -> None:
    """Write features with names, units, frame and method, and what the recording is."""
    candidate = sampled.candidate
    group.attrs["instruction"] = candidate.instruction
    group.attrs["kind"] = candidate.kind
    group.attrs["calibration"] = calibration_record.text_of(candidate.about["calibration"])
    group["timestamp"] = sampled.grid.timestamps
    for place, feature in places.items():
        if feature.is_video:
            stored = _pictures(group, place, sampled, feature)
            put_frames(stored, sampled, feature, options)
        else:
            stored = put(group, place, sampled.columns[feature.name])
        _describe(stored, feature)


def check_all(group: h5py.Group, places: Places, sampled: Sampled, options: ExportOptions) -> None:
    """Compare what ``put_all`` wrote with the recording; an EpisodeError where they differ."""
    check_array(group["timestamp"], sampled.grid.timestamps)
    for place, feature in places.items():
        if feature.is_video:
            check_frames(group[place], group.file.filename, sampled, feature, options)
        else:
            check_array(group[place], sampled.columns[feature.name])


def put(group: h5py.Group, name: str, values: npt.NDArray[Any]) -> h5py.Dataset:
    """Write an array."""
    if values.dtype == object:
        values = values.astype(h5py.string_dtype("utf-8"))
    return group.create_dataset(name, data=values)


def _describe(target: h5py.Dataset, feature: Feature) -> None:
    target.attrs["feature"] = feature.name
    target.attrs["names"] = list(feature.names)
    target.attrs["units"] = list(feature.units)
    target.attrs["frame"] = feature.frame
    target.attrs["method"] = feature.method
    target.attrs["description"] = feature.text
    target.attrs["privileged"] = feature.privileged


def _pictures(group: h5py.Group, name: str, sampled: Sampled, feature: Feature) -> h5py.Dataset:
    """An array for a camera's pictures, (N, height, width, 3) uint8 RGB, one chunk per frame.

    Compressed by LZF, which every h5py can read.
    """
    shape = tuple(feature.shape)
    return group.create_dataset(
        name,
        (sampled.grid.frames, *shape),
        np.uint8,
        chunks=(1, *shape),
        compression="lzf",
        shuffle=False,
    )


def check_array(stored: h5py.Dataset, values: npt.NDArray[Any]) -> None:
    """Compare a stored array with the intended one; an EpisodeError if they differ."""
    read_back = stored.asstr()[()] if h5py.check_string_dtype(stored.dtype) else stored[()]
    if not np.array_equal(read_back, values):
        raise EpisodeError(f"{stored.file.filename}: {stored.name}: read back something else")


def read_all(arrays: Iterable[h5py.Dataset], length: int) -> list[str]:
    """Read arrays, pictures chunk by chunk; returns errors in length and non-finite values."""
    errors = []
    for array in arrays:
        where = f"{Path(array.file.filename).name}: {array.name}"
        if array.shape[0] != length:
            errors.append(f"{where} has {array.shape[0]} rows, not {length}")
        elif array.dtype == np.uint8:
            for number in range(length):
                array[number]
        elif not np.isfinite(array[()]).all():
            errors.append(f"{where} holds values that are no numbers")
    return errors
