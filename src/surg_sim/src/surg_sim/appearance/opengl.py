"""OpenGL without a window: EGL, or OSMesa where there is no EGL.

``mujoco.Renderer`` fixes the OpenGL platform when MuJoCo is imported; here it is chosen when a
picture is first wanted, so that the physics modules stay free of OpenGL.
"""

from __future__ import annotations

import functools
import os
import subprocess
import sys
from typing import Any

import mujoco

APT_LINE = "sudo apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri libgles2 libosmesa6"
"""What brings off-screen OpenGL to a Debian machine."""

BACKENDS = ("egl", "osmesa")
"""Platforms in the order in which they are tried."""


class NoOpenGL(RuntimeError):
    """No way to render off screen on this machine; the message says what to install."""


_PROBE = """
import mujoco
from surg_sim.appearance.opengl import context
gl, mjr = context({backend!r}, mujoco.MjModel.from_xml_string("<mujoco/>"), 64, 64)
mjr.free()
gl.free()
"""


def context(
    backend: str, model: mujoco.MjModel, width: int, height: int
) -> tuple[Any, mujoco.MjrContext]:
    """An OpenGL context of ``egl`` or ``osmesa``, current in this thread, with the model's meshes.

    Width and height of the pictures in px. A process can do this for one platform only: the
    libraries stay loaded, also after a failure.
    """
    os.environ["PYOPENGL_PLATFORM"] = backend
    # Mesa's renderer without a graphics card: two threads draw these scenes no sooner than one, and
    # take a fifth more of the processor.
    os.environ.setdefault("LP_NUM_THREADS", "0")
    if backend == "egl":
        from mujoco.egl import GLContext
    else:
        from mujoco.osmesa import GLContext  # type: ignore[assignment]
    gl = GLContext(width, height)
    gl.make_current()
    # MuJoCo draws into a buffer of the size that the model names. Without a GPU it is 7 % faster in
    # one of the picture's own size.
    largest = model.vis.global_
    named = largest.offwidth, largest.offheight
    largest.offwidth, largest.offheight = width, height
    try:
        return gl, mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
    finally:
        largest.offwidth, largest.offheight = named


def probe(backend: str) -> str:
    """Try a platform in a process of its own; returns why it does not work, or nothing."""
    search = os.pathsep.join([p for p in sys.path if p])
    result = subprocess.run(
        [sys.executable, "-c", _PROBE.format(backend=backend)],
        env={**os.environ, "PYTHONPATH": search, "MUJOCO_GL": backend},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    if result.returncode == 0:
        return ""
    return (result.stderr.strip() or "no message").splitlines()[-1]


@functools.cache
def choose_backend() -> str:
    """The platform this process renders with: ``MUJOCO_GL`` if it names one, else egl, else osmesa.

    Raises:
        NoOpenGL: Neither works; the message gives the reason of each and the apt line.
    """
    wished = os.environ.get("MUJOCO_GL", "").lower()
    reasons = []
    for backend in (wished,) if wished in BACKENDS else BACKENDS:
        reason = probe(backend)
        if not reason:
            return backend
        reasons.append(f"{backend}: {reason}")
    raise NoOpenGL(
        f"No off-screen OpenGL ({'; '.join(reasons)}). The endoscope needs it: {APT_LINE}"
    )
