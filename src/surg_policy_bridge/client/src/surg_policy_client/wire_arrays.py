"""Arrays of a message: their descriptions in the header, and the buffers behind it."""

from __future__ import annotations

from typing import Any, Mapping, Sequence

import numpy as np

from surg_policy_client.header import Buffer
from surg_policy_client.spec import DTYPES
from surg_policy_client.spec_checks import MAX_NDIM
from surg_policy_client.wire_fields import MAX_ROWS

MAX_PART = 8 << 20
"""[bytes] Largest frame; both sides set it as ZeroMQ's MAXMSGSIZE."""
MAX_PARTS = 9
MAX_KEY = 128
_LITTLE = np.dtype("<i4").isnative


class WireError(ValueError):
    """An invalid message.

    Attributes:
        code: One of parts, size, magic, kind, header, keys, field, spec, dtype,
            shape, length, finite.
    """

    def __init__(self, code: str, text: str) -> None:
        super().__init__(f"{code}: {text}")
        self.code = code


def check_arrays(kind: str, described: Any, buffers: Sequence[Any]) -> None:
    """Check the descriptions against the lengths of the buffers, without allocating."""
    if type(described) is not list or len(described) != len(buffers):
        raise WireError("parts", f"{kind}: a description for each of {len(buffers)} buffers")
    if len(described) > MAX_PARTS - 1:
        raise WireError("parts", f"{kind}: {len(described)} arrays; at most {MAX_PARTS - 1}")
    seen = set()
    for item, buffer in zip(described, buffers):
        if type(item) is not dict or item.keys() != {"key", "dtype", "shape"}:
            raise WireError("keys", f"{kind}: an array has exactly key, dtype, shape")
        key, dtype, shape = item["key"], item["dtype"], item["shape"]
        if type(key) is not str or not 0 < len(key) <= MAX_KEY or key in seen:
            raise WireError("field", f"{kind}: keys of 1 to {MAX_KEY} characters, each once")
        seen.add(key)
        if type(dtype) is not str or dtype not in DTYPES:
            raise WireError("dtype", f"{key}: one of {', '.join(DTYPES)}, not {dtype!r:.40}")
        if (
            type(shape) is not list
            or len(shape) > MAX_NDIM
            or any(type(side) is not int or not 0 <= side <= MAX_PART for side in shape)
        ):
            raise WireError("shape", f"{key}: at most {MAX_NDIM} sides of 0 to {MAX_PART}")
        # With a side of 0 the size is 0, but numpy still multiplies the other sides.
        size = room = np.dtype(DTYPES[dtype]).itemsize
        for side in shape:
            size, room = size * side, room * max(side, 1)
        length = memoryview(buffer).nbytes
        if size != length:
            raise WireError("length", f"{key}: {dtype} {shape} has {size} bytes, not {length}")
        if room > MAX_PART:
            raise WireError("size", f"{key}: {dtype} {shape}: {room} bytes; at most {MAX_PART}")
    if kind == "ACT":
        good = [each["key"] for each in described] == ["chunk"]
        good = good and described[0]["dtype"] in ("f4", "f8") and len(described[0]["shape"]) == 2
        if not (good and described[0]["shape"][0] <= MAX_ROWS):
            raise WireError("shape", f"ACT: one array `chunk`, f4 or f8, [0 to {MAX_ROWS}, A]")


def check_values(kind: str, arrays: Mapping[str, np.ndarray]) -> None:
    """Check the values: finite actions, booleans of 0 or 1."""
    for key, array in arrays.items():
        if kind == "ACT" and not np.isfinite(array).all():
            raise WireError("finite", f"{key}: actions are finite numbers")
        if array.dtype == np.bool_ and array.size and int(array.view(np.uint8).max()) > 1:
            raise WireError("field", f"{key}: b1 is 0 or 1")


def dtype_name(key: str, array: np.ndarray) -> str:
    """Element type of the wire.

    Raises:
        WireError: The wire has none for it.
    """
    name = array.dtype.str[1:]
    if name not in DTYPES:
        allowed = ", ".join(np.dtype(each).name for each in DTYPES.values())
        raise WireError("dtype", f"{key}: type {array.dtype}; allowed: {allowed}")
    return name


def bytes_of(array: np.ndarray) -> Buffer:
    """Memory of the array, little-endian."""
    if array.dtype.byteorder == ">" or (array.dtype.byteorder == "=" and not _LITTLE):
        array = array.astype(array.dtype.newbyteorder("<"))
    return array.data.cast("B") if array.size else b""


def array_of(described: Mapping[str, Any], view: memoryview) -> np.ndarray:
    """A read-only view of a buffer, by its description."""
    dtype = np.dtype(DTYPES[described["dtype"]]).newbyteorder("<")
    flat = np.frombuffer(view, dtype) if view.nbytes else np.empty(0, dtype)
    # ZeroMQ puts small frames at unaligned addresses, which some libraries cannot read.
    flat = flat if flat.flags.aligned else flat.copy()
    shaped = flat.reshape(described["shape"])
    shaped.flags.writeable = False
    return shaped
