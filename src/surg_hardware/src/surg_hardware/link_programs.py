"""Which program drives the arm of a link, and in which Python."""

from __future__ import annotations

import sys
from pathlib import Path

UR, UR_DRIVER = "ur", "surg_hardware.ur.ur_driver"
"""The link that has a driver of its own, and its module."""
ADAPTERS = {
    "fr3": "surg_hardware.franka.fr3_adapter",
    "panda": "surg_hardware.franka.panda_adapter",
}
"""The other links of the platform -> module of their adapter, which `adapter_driver` runs."""
REQUIREMENTS = "packages.lock"
"""Packages of a driver's own environment, pinned with hashes; beside the driver."""
_PACKAGE = Path(__file__).resolve().parent


class NoProgram(ValueError):
    """There is nothing that drives this link; says what is missing, and the cure."""


def requirements(link: str, driver: Path | None) -> Path | None:
    """The packages that a link's driver needs; None: it needs none.

    Args:
        link: The link, as the cell names it.
        driver: Folder of a driver from elsewhere.
    """
    if driver is None and link in ADAPTERS:
        driver = _PACKAGE.parent.joinpath(*ADAPTERS[link].split(".")).parent
    lock = driver and driver / REQUIREMENTS
    return lock if lock is not None and lock.is_file() else None


def environment(lock: Path) -> Path:
    """The folder of the environment for these packages: beside the platform's own."""
    return Path(sys.prefix).parent / f".venv-link-{lock.parent.name}"


def driver_name(link: str, driver: Path | None) -> str:
    """What drives an arm: the link's name, or the folder of a driver from elsewhere.

    Raises:
        NoProgram: Nothing does.
    """
    if driver is None and link not in (UR, *ADAPTERS):
        raise NoProgram(
            f"link: {link!r} has a section hardware, and its YAML names no driver: "
            "add 'driver: FOLDER' to it, or remove hardware and start the link by hand"
        )
    return str(driver or link)


def driver_words(link: str, driver: Path | None) -> list[str]:
    """The words that start the driver of a link.

    Raises:
        NoProgram: There is no driver, or its environment is missing.
    """
    driver_name(link, driver)
    python = sys.executable
    if (lock := requirements(link, driver)) is not None:
        python = str(environment(lock) / "bin" / "python")
        if not Path(python).is_file():
            raise NoProgram(f"{lock}: its environment {python} is missing: ./surg up makes it")
    of_ur = driver is None and link == UR
    return [python, "-s", "-m", UR_DRIVER if of_ur else "surg_hardware.adapter_driver"]


def search_path() -> str:
    """PYTHONPATH of a driver with an environment of its own: this package, and nothing of ROS."""
    return str(_PACKAGE.parent)
