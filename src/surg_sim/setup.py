"""Packaging of surg_sim, read by catkin (catkin_python_setup) and by pip alike."""

from pathlib import Path
from shutil import copytree

from setuptools import find_packages, setup
from setuptools.command.build_py import build_py

HERE = Path(__file__).resolve().parent
CARRIED = {
    "cells": HERE.parents[1] / "cells",
    **{
        f"src/surg_description/{part}": HERE.parent / "surg_description" / part
        for part in ("robots", "instruments", "links", "urdf")
    },
}
"""What a machine without a checkout needs of it; placed as the cells' paths expect it."""


class BuildWithData(build_py):
    """Puts cells, robots and instruments into the package (see ``cell_files``)."""

    def run(self) -> None:
        """Build, then copy."""
        super().run()
        for place, source in CARRIED.items():
            copytree(source, Path(self.build_lib, "surg_sim", "data", place), dirs_exist_ok=True)


setup(
    name="surg_sim",
    version="0.1.0",
    description="MuJoCo phantom of the surgical-robotics platform: arms, trocars, tasks",
    license="Apache-2.0",
    packages=find_packages("src"),
    package_dir={"": "src"},
    package_data={"surg_sim": ["physics/assets/*.xml", "py.typed"]},
    cmdclass={"build_py": BuildWithData},
    python_requires=">=3.11",
    install_requires=["numpy", "mujoco>=4.0,<4.1", "matplotlib", "surg_core"],
    extras_require={"gym": ["gymnasium>=1.2,<2"], "video": ["av>=10"]},
)
