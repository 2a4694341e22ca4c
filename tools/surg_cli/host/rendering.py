"""Off-screen OpenGL of the nodes: EGL, or OSMesa where EGL does not work."""

from __future__ import annotations

import ctypes.util
import os
import subprocess

from surg_cli.host import paths
from surg_cli.host.terminal import warn

# What mujoco.egl does first, in a process of its own: a broken driver may crash it.
_INITIALIZE = """
import ctypes, os
egl = ctypes.CDLL("libEGL.so.1")
egl.eglGetProcAddress.restype = ctypes.c_void_p
pointer, number = ctypes.c_void_p, ctypes.c_int
query = ctypes.CFUNCTYPE(number, number, pointer, pointer)(
    egl.eglGetProcAddress(b"eglQueryDevicesEXT"))
display = ctypes.CFUNCTYPE(pointer, number, pointer, pointer)(
    egl.eglGetProcAddress(b"eglGetPlatformDisplayEXT"))
devices, count = (pointer * 16)(), number()
assert query(16, devices, ctypes.byref(count)) and count.value
found = devices[:count.value]
if chosen := os.environ.get("MUJOCO_EGL_DEVICE_ID"):
    found = [found[int(chosen)]]
egl.eglInitialize.argtypes = [pointer] * 3
assert any(egl.eglInitialize(display(0x313F, each, None), None, None) for each in found)
"""


def egl_works() -> bool:
    """Whether EGL finds a device that it can initialise; takes 0.1 s."""
    try:
        done = subprocess.run(
            [str(paths.SYSTEM_PYTHON), "-s", "-c", _INITIALIZE],
            capture_output=True,
            check=False,
            timeout=30,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0


def backend() -> str:
    """Value of MUJOCO_GL: the caller's, else egl, else osmesa with a sentence."""
    if wished := os.environ.get("MUJOCO_GL", ""):
        return wished
    if egl_works() or ctypes.util.find_library("OSMesa") is None:
        return "egl"
    warn("surg: EGL does not work on this machine; OSMesa draws the pictures, on the processor")
    return "osmesa"
