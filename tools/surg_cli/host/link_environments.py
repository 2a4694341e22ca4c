"""Python environments of links whose drivers need packages that the platform does not have.

A driver's folder may hold a ``packages.lock``. `./surg up` makes the environment for it at the
first start, and again when the file has changed.
"""

from __future__ import annotations

import surg_core
from surg_cli.host import logged, paths, provision
from surg_cli.host.terminal import CliError, Progress, say
from surg_hardware import link_programs

LOG = paths.STATE / "logs" / "link-environment.log"
_STAMP = "lock.sha256"


def make_ready(arm: surg_core.Arm) -> None:
    """Make the environment of an arm's driver, if it needs one and it is not there.

    Raises:
        CliError: A package cannot be had; names the file that lists it.
    """
    lock = link_programs.requirements(arm.link, arm.driver)
    if lock is None:
        return
    folder = link_programs.environment(lock)
    stamp, wanted = folder / _STAMP, paths.file_digest(lock)
    if stamp.is_file() and stamp.read_text("utf-8") == wanted:
        return
    say(f"Environment of the link '{arm.link}': {folder} (log: {LOG})")
    try:
        with Progress("environment") as progress:
            venv = [str(paths.SYSTEM_PYTHON), "-m", "venv", "--clear", str(folder)]
            logged.run(venv, LOG, progress)
            provision.pip_install(folder / "bin" / "python", lock, LOG, progress)
    except CliError as problem:
        raise CliError(f"{lock}: its packages cannot be installed: {problem}") from problem
    paths.write_text(stamp, wanted)
