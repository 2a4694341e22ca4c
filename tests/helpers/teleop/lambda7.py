"""The stand-in for the Force Dimension library (`lambda7_stub.cpp`), from the test's side."""

from __future__ import annotations

import ctypes
import mmap
import subprocess
from pathlib import Path

STUB = Path(__file__).with_name("lambda7_stub.cpp")


class State(ctypes.Structure):
    """What test and library share; field by field as in the C++ file."""

    _fields_ = [
        ("p", ctypes.c_double * 3),
        ("R", ctypes.c_double * 9),
        ("gripper", ctypes.c_double),
        ("force", ctypes.c_double * 7),
        ("max_force", ctypes.c_double),
        ("error", ctypes.c_char * 128),
        ("poses", ctypes.c_int64),
        ("forces", ctypes.c_int64),
        ("nonzero_forces", ctypes.c_int64),
        *((name, ctypes.c_int32) for name in ("present", "left_handed", "wrist", "has_gripper")),
        ("initialised", ctypes.c_int32),
        ("init_works", ctypes.c_int32),
        ("fail_pose", ctypes.c_int32),
        ("fail_gripper", ctypes.c_int32),
        ("fail_force", ctypes.c_int32),
        ("old", ctypes.c_int32),
        ("buttons", ctypes.c_uint32),
        ("n_calls", ctypes.c_int32),
        ("calls", ctypes.c_int32 * 64),
    ]


def build(folder: Path, *options: str) -> Path:
    """Compiles the library, with the options of a compiler; returns its file."""
    library = folder / "libdrd.so.3.17.0"
    argv = ["c++", "-std=c++17", "-shared", "-fPIC", *options, str(STUB), "-o", str(library)]
    subprocess.run(argv, check=True)
    return library


def share(path: Path) -> State:
    """A device that is there, right-handed, initialised, at rest in its middle."""
    path.write_bytes(bytes(ctypes.sizeof(State)))
    with path.open("r+b") as file:
        state = State.from_buffer(mmap.mmap(file.fileno(), 0))
    state.R[:] = [1, 0, 0, 0, 1, 0, 0, 0, 1]
    state.present = state.wrist = state.has_gripper = state.initialised = state.init_works = 1
    return state


def calls(state: State) -> str:
    """What was called so far, one letter each, without the cycle's own."""
    return "".join(chr(call) for call in state.calls[: state.n_calls])
