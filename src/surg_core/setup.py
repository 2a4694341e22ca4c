"""Tells catkin where the pure Python part is. pip does not use this file: see pyproject.toml."""

from setuptools import setup

setup(
    name="surg_core",
    version="0.1.0",
    packages=[
        "surg_core",
        "surg_core.force",
        "surg_core.hand",
        "surg_core.host",
        "surg_core.pictures",
        "surg_core.reading",
    ],
    package_dir={"": "python"},
    package_data={"surg_core": ["py.typed"]},
)
