"""Debian packages and the Python environment: bring the machine to what the platform needs.

Nothing is done that is done already: `dpkg-query` is asked for the listed packages (20 ms), and
`.venv` carries a stamp of the lock file it was filled from.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from surg_cli import paths
from surg_cli.environment import clean
from surg_cli.terminal import Problem, Progress, say

VENV_STAMP = paths.VENV / ".surg-lock"
APT_OPTIONS = ("-o", "DPkg::Lock::Timeout=600", "-y", "--no-install-recommends")
# apt-get prints: Get, Selecting, Preparing, Unpacking, Setting up.
APT_LINES_PER_PACKAGE = 5


def listed_packages(path: Path = paths.APT_LIST) -> list[str]:
    """Names in the package list: the first word of each line that is not a comment.

    Args:
        path: One package per line, `#` starts a comment.
    """
    lines = (line.partition("#")[0].split() for line in path.read_text("utf-8").splitlines())
    return [words[0] for words in lines if words]


def missing_packages(names: Sequence[str]) -> list[str]:
    """Those of `names` that dpkg does not call installed.

    Args:
        names: Debian package names.

    Raises:
        Problem: When this is not a Debian system.
    """
    if shutil.which("dpkg-query", path="/usr/bin:/bin") is None:
        raise Problem("dpkg-query is missing: the platform is set up on Debian 12 (bookworm)")
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


def install_packages(log: Path) -> bool:
    """Install what is missing from the package list.

    Args:
        log: File for the output of apt-get.

    Returns:
        Whether anything had to be installed.

    Raises:
        Problem: Without root and sudo, with the one line to run; or when apt-get fails.
    """
    missing = missing_packages(listed_packages())
    if not missing:
        return False
    line = "apt-get install -y --no-install-recommends " + " ".join(missing)
    prefix = _root_prefix()
    if prefix is None:
        raise Problem(
            f"{len(missing)} Debian packages are missing, and neither root nor passwordless sudo "
            f"is at hand. Run this once as root, then ./surg again:\n\n"
            f"apt-get update && {line}\n"
        )
    say(f"Debian packages: installing {len(missing)} of {len(listed_packages())} (log: {log})")
    log.parent.mkdir(parents=True, exist_ok=True)
    base = [*prefix, "/usr/bin/env", "DEBIAN_FRONTEND=noninteractive", "apt-get", *APT_OPTIONS]
    with Progress("apt-get") as progress:
        _logged([*base, "update"], log, progress, "w")
        _logged([*base, "install", *missing], log, progress, "a")
    still = missing_packages(missing)
    if still:
        raise Problem(f"apt-get ended well but {', '.join(still)} is still missing; see {log}")
    return True


def install_python(log: Path) -> bool:
    """Make `.venv` and fill it from the lock file.

    numpy, OpenCV and pyzmq stay Debian's: `.venv` sees the system's packages, and the lock names
    only what Debian 12 does not have.

    Args:
        log: File for the output of pip.

    Returns:
        Whether anything had to be done.

    Raises:
        Problem: When a step fails; the text holds the last lines of its output.
    """
    wanted = paths.file_digest(paths.LOCK_FILE)
    if paths.VENV_PYTHON.exists() and VENV_STAMP.exists() and VENV_STAMP.read_text() == wanted:
        return False
    say(f"Python environment: {paths.VENV} (log: {log})")
    log.parent.mkdir(parents=True, exist_ok=True)
    with Progress("Python environment") as progress:
        if not paths.VENV_PYTHON.exists():
            make = [str(paths.SYSTEM_PYTHON), "-m", "venv", "--system-site-packages"]
            _logged([*make, str(paths.VENV)], log, progress, "w")
        pip = [str(paths.VENV_PYTHON), "-m", "pip", "--disable-pip-version-check", "install"]
        strict = ["--no-deps", "--require-hashes", "--only-binary", ":all:"]
        _logged([*pip, *strict, "-r", str(paths.LOCK_FILE)], log, progress, "a")
    paths.write_text(VENV_STAMP, wanted)
    return True


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


def _logged(argv: Sequence[str], log: Path, progress: Progress, mode: str) -> None:
    """Run a program with its output in a log file and its progress shown.

    Args:
        argv: Program and arguments.
        log: The file; `mode` says whether it is replaced ("w") or continued ("a").
        progress: Redrawn with each line.
        mode: See `log`.

    Raises:
        Problem: When it fails.
    """
    lines: list[str] = []
    total = 0
    with log.open(mode, encoding="utf-8") as stream:
        stream.write("$ " + " ".join(argv) + "\n")
        process = subprocess.Popen(
            argv,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            env=clean(),
        )
        assert process.stdout is not None
        for line in process.stdout:
            stream.write(line)
            lines.append(line.rstrip())
            announced = re.search(r"(\d+) newly installed", line)
            if announced:
                total = len(lines) + APT_LINES_PER_PACKAGE * int(announced.group(1))
            progress.update(min(len(lines) / total, 1.0) if total else None, line.strip()[:60])
    if process.wait() != 0:
        tail = "\n".join(lines[-15:])
        raise Problem(f"failed: {' '.join(argv)[:200]}\n{tail}\nThe whole output: {log}")
