"""Packaging of surg_sim, read by catkin (catkin_python_setup) and by pip alike."""

from pathlib import Path
from shutil import copytree

from setuptools import find_packages, setup
from setuptools.command.build_py import build_py
from setuptools.command.sdist import sdist

HERE = Path(__file__).resolve().parent
DATA = Path("src", "surg_sim", "data")
CARRIED = {
    "cells": HERE.parents[1] / "cells",
    **{
        f"src/surg_description/{part}": HERE.parent / "surg_description" / part
        for part in ("robots", "instruments", "links", "force_sensors", "urdf")
    },
}
"""What a machine without a checkout needs of it; placed as the cells' paths expect it."""


def carry(target: Path) -> None:
    """Copy cells, robots and instruments from the checkout, or from the archive itself."""
    for place, beside in CARRIED.items():
        source = beside if beside.is_dir() else HERE / DATA / place
        if not source.is_dir():
            raise SystemExit(
                f"surg_sim needs {beside}: build it inside the checkout, or from the archive that "
                "`python3 setup.py sdist` writes there"
            )
        copytree(source, target / place, dirs_exist_ok=True)


class BuildWithData(build_py):
    """Puts cells, robots and instruments into the package (see ``cell_files``)."""

    def run(self) -> None:
        """Build, then copy."""
        super().run()
        carry(Path(self.build_lib, "surg_sim", "data"))


class ArchiveWithData(sdist):
    """Writes an archive that builds without a checkout."""

    def make_release_tree(self, base_dir: str, files: list[str]) -> None:
        """Copy the sources, then the data."""
        super().make_release_tree(base_dir, files)
        carry(Path(base_dir) / DATA)


setup(
    name="surg_sim",
    version="0.1.0",
    description="MuJoCo phantom of the surgical-robotics platform: arms, trocars, tasks",
    license="Apache-2.0",
    packages=find_packages("src"),
    package_dir={"": "src"},
    package_data={"surg_sim": ["physics/assets/*.xml", "py.typed"]},
    cmdclass={"build_py": BuildWithData, "sdist": ArchiveWithData},
    python_requires=">=3.11",
    install_requires=["numpy", "mujoco>=4.0,<4.1", "matplotlib", "surg_core"],
    extras_require={"gym": ["gymnasium>=1.2,<2"], "video": ["av>=10"]},
)
