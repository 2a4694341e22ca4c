"""Checks before anything starts: where the checkout lies, who may write it, how much disk is free.

Each check ends in one sentence with the cure.
"""

from __future__ import annotations

import errno
import getpass
import os
import shutil
from pathlib import Path

from surg_cli.host import paths
from surg_cli.host.terminal import CliError

FREE_GIB = 2.0
"""[GiB] Space below which nothing starts: the recorder would refuse, or the set-up fail halfway."""
CURES = {
    errno.ENOSPC: "the disk is full; remove old runs/ folders",
    errno.EACCES: "this user may not do that; use a checkout and an --out folder of your own",
    errno.EPERM: "this user may not do that; use a checkout and an --out folder of your own",
    errno.EADDRINUSE: "another program has that port: ss -ltnp names it; end it, or choose another",
    errno.EROFS: "the file system is read-only; name a folder elsewhere by --out",
}


def check_path(root: Path = paths.ROOT) -> None:
    """Check the folder of the checkout.

    Raises:
        CliError: Its path has a space, which catkin refuses.
    """
    if any(letter.isspace() for letter in str(root)):
        raise CliError(
            f"the path '{root}' has a space, and catkin cannot build there; move the checkout to "
            "a path without spaces"
        )


def check_tree(root: Path = paths.ROOT) -> None:
    """Check that a set-up or a build can write into the checkout.

    Raises:
        CliError: This user cannot write it; names its owner.
    """
    for folder in (root, *(root / name for name in ("build", "devel", ".surg", ".venv"))):
        if folder.exists() and not os.access(folder, os.W_OK):
            raise CliError(
                f"{folder} must be set up or built, but {_user()} cannot write it (owner: "
                f"{_owner(folder)}); run ./surg dev build as its owner, or use your own checkout"
            )


def check_space(folder: Path) -> None:
    """Check the disk of a folder, which need not exist yet.

    Raises:
        CliError: Less than `FREE_GIB` are free.
    """
    free = shutil.disk_usage(paths.existing(folder)).free / 2**30
    if free < FREE_GIB:
        raise CliError(
            f"{folder}: {free:.1f} GiB are free on this disk, at least {FREE_GIB:.0f} GiB are "
            "needed; remove old runs/ folders, or name a folder on another disk by --out"
        )


def sentence(error: OSError) -> str:
    """What a person reads of an error of the operating system: what, where, and the cure."""
    where = f"{error.filename}: " if error.filename else ""
    text = f"{where}{error.strerror or error}"
    cure = CURES.get(error.errno or 0, "")
    return f"{text}; {cure}" if cure else text


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return f"user {os.getuid()}"


def _owner(folder: Path) -> str:
    try:
        return folder.owner()
    except (KeyError, OSError):
        return "unknown"
