"""Debian packages and the Python environment: bring the machine to what the platform needs.

Nothing is done that is done already: `dpkg-query` is asked for the listed packages (20 ms), and
`.venv` carries a stamp of the lock file it was filled from.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from surg_cli.host import distribution, logged, paths, preflight, workspace
from surg_cli.host.terminal import CliError, Progress, say

VENV_STAMP = paths.VENV / ".surg-lock"
DDS_STAMP = paths.VENV / ".surg-dds-lock"
APT_OPTIONS = ("-o", "DPkg::Lock::Timeout=600", "-y", "--no-install-recommends")
LATER = ("opencv", "torch", "later")
"""Sets of the package list (lines `# == NAME`) that wait for a command that needs them."""
OPTIONAL = ("gstreamer",)
"""Sets that are installed on request only."""


def make_ready(everything: bool = False, optional: Sequence[str] = ()) -> bool:
    """Install missing packages and fill `.venv`; returns whether anything had to be done.

    Args:
        everything: Also the sets of ``LATER``.
        optional: Also these sets of ``LATER`` or ``OPTIONAL``.
    """
    preflight.check_path()
    logs = paths.STATE / "logs"
    done = install_packages(logs / "apt.log", everything, optional)
    done |= install_python(logs / "pip.log")
    return (everything and need_dds()) or done


def listed_packages(
    path: Path = paths.APT_LIST, everything: bool = True, optional: Sequence[str] = ()
) -> list[str]:
    """Names in the package list: the first word of each line, `#` starts a comment.

    Without ``everything`` only those above the first set; ``optional`` names sets of ``LATER`` or
    ``OPTIONAL`` that are added.
    """
    wanted = {"", *(LATER if everything else ()), *optional}
    found, current = [], ""
    for line in path.read_text("utf-8").splitlines():
        current = line.removeprefix("# == ") if line.startswith("# == ") else current
        words = line.partition("#")[0].split()
        if words and current in wanted:
            found.append(words[0])
    return found


def missing_packages(names: Sequence[str]) -> list[str]:
    """Those Debian packages that dpkg does not call installed.

    Raises:
        CliError: This is not a system of Debian's kind, or its Python is too old.
    """
    here = distribution.here()
    here.untried()
    names = [here.package(name) for name in names]
    query = subprocess.run(
        ["/usr/bin/dpkg-query", "-W", "-f=${Package} ${db:Status-Status}\\n", *names],
        capture_output=True,
        text=True,
        check=False,
        env={"LC_ALL": "C", "PATH": "/usr/bin:/bin"},
    )
    installed = {
        line.split()[0] for line in query.stdout.splitlines() if line.endswith(" installed")
    }
    return [name for name in names if name not in installed]


def install_packages(log: Path, everything: bool = False, optional: Sequence[str] = ()) -> bool:
    """Install what is missing from the package list; returns whether anything was.

    Raises:
        CliError: Without root and sudo, with the one line to run; or apt-get fails.
    """
    listed = listed_packages(everything=everything, optional=optional)
    missing = missing_packages(listed)
    if not missing:
        return False
    line = "apt-get install -y --no-install-recommends " + " ".join(missing)
    prefix = _root_prefix()
    if prefix is None:
        raise CliError(
            f"{len(missing)} Debian packages are missing, and neither root nor passwordless sudo "
            f"is at hand. Run this once as root, then ./surg again:\n\n"
            f"apt-get update && {line}\n"
        )
    if warning := distribution.here().untried():
        say(warning)
    say(f"Debian packages: installing {len(missing)} of {len(listed)} (log: {log})")
    base = [*prefix, "/usr/bin/env", "DEBIAN_FRONTEND=noninteractive", "apt-get", *APT_OPTIONS]
    with Progress("apt-get") as progress:
        logged.run([*base, "update"], log, progress, anew=True)
        logged.run([*base, "install", *missing], log, progress)
    still = missing_packages(missing)
    if still:
        raise CliError(f"apt-get ended well but {', '.join(still)} is still missing; see {log}")
    return True


def need_opencv() -> None:
    """Install what real endoscopes and simulated lenses need; a `demo` does without it."""
    install_packages(paths.STATE / "logs" / "apt.log", optional=("opencv",))


def overview(everything: bool, optional: Sequence[str] = ()) -> str:
    """What the first use of a command will do, before it begins; empty if all of it is done."""
    stages = []
    if missing := missing_packages(listed_packages(everything=everything, optional=optional)):
        stages.append(f"{len(missing)} Debian packages (1 to 5 minutes)")
    if not python_is_current():
        stages.append("a Python environment (100 MB, half a minute)")
    if not workspace.is_current():
        stages.append("a build (2 to 6 minutes on 2 idle cores)")
    return f"first: {', then '.join(stages)}" if stages else ""


def python_is_current() -> bool:
    """Whether `.venv` was filled from the lock file as it is, on a machine like this one."""
    return paths.VENV_PYTHON.exists() and _is_filled(paths.LOCK_FILE, VENV_STAMP)


def _is_filled(lock: Path, stamp: Path) -> bool:
    return stamp.exists() and stamp.read_text() == _filled(lock)


def _filled(lock: Path) -> str:
    """What the stamp of a lock file says."""
    return f"{paths.file_digest(lock)} {distribution.here().key}"


def install_python(log: Path) -> bool:
    """Make `.venv` and fill it from the lock file; returns whether anything had to be done.

    numpy, OpenCV and pyzmq stay Debian's: `.venv` sees the system's packages, and the lock names
    only what Debian 12 does not have.

    Raises:
        CliError: A step fails; the text holds the last lines of its output.
    """
    if python_is_current():
        return False
    preflight.check_tree()
    preflight.check_space(paths.VENV)
    made_on = VENV_STAMP.read_text().partition(" ")[2] if VENV_STAMP.exists() else ""
    if made_on not in ("", distribution.here().key):
        say(f"{paths.VENV} was made on {made_on}, this is {distribution.here().key}: made anew")
        shutil.rmtree(paths.VENV)
    say(f"Python environment: {paths.VENV} (log: {log})")
    with Progress("Python environment") as progress:
        if not _has_pip():
            shutil.rmtree(paths.VENV, ignore_errors=True)  # Ctrl-C ended its making
            make = [str(paths.SYSTEM_PYTHON), "-m", "venv", "--system-site-packages"]
            logged.run([*make, str(paths.VENV)], log, progress, anew=True)
        pip_install(paths.VENV_PYTHON, paths.LOCK_FILE, log, progress)
    paths.write_text(VENV_STAMP, _filled(paths.LOCK_FILE))
    return True


def need_dds() -> bool:
    """Fill `.venv` with what the ROS 2 gateway needs; returns whether anything had to be done."""
    if _is_filled(paths.DDS_LOCK, DDS_STAMP):
        return False
    with Progress("DDS, for ROS 2 (59 MB)") as progress:
        log = paths.STATE / "logs" / "pip-dds.log"
        pip_install(paths.VENV_PYTHON, paths.DDS_LOCK, log, progress)
    paths.write_text(DDS_STAMP, _filled(paths.DDS_LOCK))
    return True


def pip_install(python: Path, lock: Path, log: Path, progress: Progress) -> None:
    """Install what a lock file lists, and nothing else, for the Python of an environment."""
    pip = [str(python), "-m", "pip", "--disable-pip-version-check", "install"]
    strict = ["--no-deps", "--require-hashes", "--only-binary", ":all:"]
    logged.run([*pip, *strict, "-r", str(lock)], log, progress)


def _has_pip() -> bool:
    """Whether `.venv` was made to its end: pip comes last."""
    if not paths.VENV_PYTHON.exists():
        return False
    asked = subprocess.run(
        [str(paths.VENV_PYTHON), "-I", "-m", "pip", "--version"], capture_output=True, check=False
    )
    # Debian's pip, if installed, would answer for a folder that has none.
    return asked.returncode == 0 and str(paths.VENV) in asked.stdout.decode(errors="replace")


def _root_prefix() -> list[str] | None:
    """Words put before a command to run it as root; None when that is not possible."""
    if os.geteuid() == 0:
        return []
    sudo = shutil.which("sudo", path="/usr/bin:/bin:/usr/local/bin")
    if sudo is None:
        return None
    allowed = subprocess.run(
        [sudo, "-n", "true"], capture_output=True, stdin=subprocess.DEVNULL, check=False
    )
    return [sudo, "-n"] if allowed.returncode == 0 else None
