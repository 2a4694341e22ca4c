"""The environment of every program of the platform, whatever shell or Python the caller uses."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Mapping
from pathlib import Path

from surg_cli.host import paths, rendering
from surg_cli.host.terminal import CliError

# A pyenv or conda Python announces itself in these; inherited, it breaks Debian's modules.
FOREIGN_PYTHON = ("PYTHONHOME", "PYTHONPATH", "CONDA_PREFIX", "CONDA_DEFAULT_ENV", "PYENV_VERSION")
# What a sourced workspace leaves behind: another workspace must not leak into this one.
FOREIGN_ROS = ("ROS_PACKAGE_PATH", "CMAKE_PREFIX_PATH", "ROS_ROOT", "ROS_DISTRO", "PKG_CONFIG_PATH")
# Whoever takes a picture from a socket asks the C library for a megabyte at a time. Left alone it
# gives each back to the kernel at once, and a node with two cameras then waits for 10,000 fresh
# pages a second: 3 % of a core.
KEEPS_MEMORY = {
    "MALLOC_MMAP_THRESHOLD_": str(16 << 20),
    "MALLOC_TRIM_THRESHOLD_": str(32 << 20),
}
SYSTEM_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"


def clean(base: Mapping[str, str] | None = None) -> dict[str, str]:
    """The caller's environment, or ``base``, without foreign Pythons and ROS workspaces.

    The platform's `.venv` and Debian's folders come first on PATH, the caller's follow.
    """
    env = dict(os.environ if base is None else base)
    for name in (*FOREIGN_PYTHON, *FOREIGN_ROS):
        env.pop(name, None)
    ours = [str(paths.VENV / "bin"), *SYSTEM_PATH.split(":")]
    theirs = [part for part in env.get("PATH", "").split(":") if part and part not in ours]
    env["PATH"] = ":".join([*ours, *theirs])
    env["VIRTUAL_ENV"] = str(paths.VENV)
    env["LC_ALL"] = env.get("LC_ALL") or "C.UTF-8"
    return env


def for_nodes(
    port: int | None = None, ros_home: Path | None = None, draws: bool = True
) -> dict[str, str]:
    """The environment nodes run in: the built workspace, a master, the loopback interface.

    Without a port ROS_MASTER_URI stays as the caller has it. ``ros_home`` (default `.surg/ros`)
    becomes ROS_HOME, and its `ros_log` ROS_LOG_DIR. ``draws``: what draws is looked for, which a
    broken driver can make slow.

    Raises:
        CliError: The workspace has not been built.
    """
    setup = paths.DEVEL / "setup.bash"
    if not setup.exists():
        raise CliError(f"the workspace is not built: {setup} is missing; run ./surg dev build")
    # setup.bash reads variables that may be unset.
    script = 'set +u; . "$1" >/dev/null && env -0'
    sourced = subprocess.run(
        ["/bin/bash", "-c", script, "bash", str(setup)],
        env=clean(),
        capture_output=True,
        check=False,
    )
    if sourced.returncode != 0:
        raise CliError(f"cannot source {setup}: {sourced.stderr.decode(errors='replace').strip()}")
    pairs = (item.partition("=") for item in sourced.stdout.decode().split("\0") if "=" in item)
    env = {name: value for name, _, value in pairs}
    home = ros_home or paths.STATE / "ros"
    env.update(
        ROS_VERSION="1",
        ROS_IP="127.0.0.1",
        ROS_HOSTNAME="localhost",
        ROS_PACKAGE_PATH=f"{paths.ROOT / 'src'}:/usr/share",
        ROS_HOME=str(home),
        ROS_LOG_DIR=str(home / "ros_log"),
        PYTHONUNBUFFERED="1",
        **KEEPS_MEMORY,
    )
    if draws:
        env["MUJOCO_GL"] = rendering.backend()
    if port is not None:
        env["ROS_MASTER_URI"] = f"http://localhost:{port}"
    else:
        env.setdefault("ROS_MASTER_URI", "http://localhost:11311")
    return env
