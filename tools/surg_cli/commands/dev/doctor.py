"""`./surg dev doctor`: lists what is installed, missing and running, and how to repair it."""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
from dataclasses import dataclass

from surg_cli.graph import master, running
from surg_cli.host import distribution, environment, paths, provision, workspace
from surg_cli.host.terminal import CliError, report_findings

FREE_GIB = 3.0
# Renders one image off-screen, in a process of its own: a broken driver may crash it.
RENDER = (
    "import mujoco\n"
    "xml = '<mujoco><worldbody><geom size=\".1\"/></worldbody></mujoco>'\n"
    "model = mujoco.MjModel.from_xml_string(xml)\n"
    "renderer = mujoco.Renderer(model, 32, 32)\n"
    "data = mujoco.MjData(model)\n"
    "mujoco.mj_forward(model, data)\n"
    "renderer.update_scene(data)\n"
    "assert renderer.render().shape == (32, 32, 3)\n"
)


@dataclass(frozen=True)
class Finding:
    """One line of the report, with what to do; ``good`` is None for information."""

    good: bool | None
    what: str
    text: str
    cure: str = ""


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """There are no options."""


def main(options: argparse.Namespace, command: str) -> int:
    """Print all findings; exit status 1 if one is bad."""
    return report_findings(_machine())


def _machine() -> list[Finding]:
    """All findings about this machine and checkout."""
    return [
        _system(),
        _packages(),
        _python(),
        _build(),
        *_rendering(),
        _space(),
        _default_port(),
        *_running(),
    ]


def _system() -> Finding:
    """Distribution, cores and memory."""
    here = distribution.here()
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    text = f"{here.title}, {len(os.sched_getaffinity(0))} cores, {memory:.1f} GiB"
    return Finding(here.tried, "system", text, "" if here.tried else "use Debian 13 or 12")


def _packages() -> Finding:
    """Debian packages."""
    names = provision.listed_packages(everything=False)
    try:
        missing = provision.missing_packages(names)
    except CliError as problem:
        return Finding(False, "Debian packages", str(problem))
    if missing:
        return Finding(
            False, "Debian packages", f"missing: {', '.join(missing)}", "./surg dev setup"
        )
    return Finding(True, "Debian packages", f"all {len(names)} installed")


def _python() -> Finding:
    """The virtual environment."""
    if not paths.VENV_PYTHON.exists():
        return Finding(False, "Python environment", f"{paths.VENV} is missing", "./surg dev setup")
    if not provision.python_is_current():
        older = "older than requirements.lock, or of another system"
        return Finding(False, "Python environment", older, "./surg dev setup")
    code = "import mujoco, numpy; print('mujoco', mujoco.__version__, 'numpy', numpy.__version__)"
    done = _run([str(paths.VENV_PYTHON), "-s", "-c", code])
    if done.returncode != 0:
        return Finding(
            False, "Python environment", done.stderr.strip()[-200:], "rm -r .venv; ./surg"
        )
    good = "numpy 1." in done.stdout
    cure = "" if good else f"{paths.VENV_PYTHON} -m pip uninstall numpy (Debian's is needed)"
    return Finding(good, "Python environment", done.stdout.strip(), cure)


def _build() -> Finding:
    """The devel space."""
    if not (paths.DEVEL / "setup.bash").exists():
        return Finding(False, "build", f"{paths.DEVEL} is missing", "./surg dev build")
    if not workspace.is_current():
        return Finding(None, "build", "sources have changed since; the next command builds")
    return Finding(True, "build", f"{paths.DEVEL} is current")


def _rendering() -> list[Finding]:
    """Off-screen OpenGL with both drivers."""
    if not paths.VENV_PYTHON.exists():
        return []
    findings = []
    for driver in ("egl", "osmesa"):
        argv = [str(paths.VENV_PYTHON), "-s", "-c", RENDER]
        done = _run(argv, {"MUJOCO_GL": driver})
        if done.returncode == 0:
            findings.append(Finding(True, f"rendering by {driver}", "works"))
        else:
            lines = done.stderr.strip().splitlines()
            text = lines[-1][:160] if lines else f"ended with {done.returncode}"
            other = "osmesa" if driver == "egl" else "egl"
            cure = f"./surg dev setup, or MUJOCO_GL={other} before ./surg"
            findings.append(Finding(False, f"rendering by {driver}", text, cure))
    return findings


def _space() -> Finding:
    """Disk space for recordings."""
    free = shutil.disk_usage(paths.ROOT).free / 2**30
    good = free >= FREE_GIB
    return Finding(good, "disk", f"{free:.1f} GiB free", "" if good else "remove old runs/ folders")


def _default_port() -> Finding:
    """Whether ROS's default port is free for `up`."""
    taken = master.port_in_use(11311)
    ours = any(system.port == 11311 for system in running.systems())
    if taken and not ours:
        answers = master.alive("http://localhost:11311")
        who = "a ROS master" if answers else "another program"
        return Finding(None, "port 11311", f"held by {who}", "./surg up CELL --port P")
    return Finding(None, "port 11311", "held by a system of this checkout" if taken else "free")


def _running() -> list[Finding]:
    """Systems of this checkout."""
    return [
        Finding(None, "running", f"{s.command} of {s.cell} on port {s.port}, logs in {s.logs}")
        for s in running.systems()
    ] or [Finding(None, "running", "nothing of this checkout")]


def _run(argv: list[str], extra: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    """Run a short program in a clean environment."""
    env = {**environment.clean(), **(extra or {})}
    return subprocess.run(argv, env=env, capture_output=True, text=True, check=False, timeout=60)
