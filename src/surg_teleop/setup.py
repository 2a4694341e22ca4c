"""Build of surg_teleop, read by catkin and by pip alike."""

import setuptools

setuptools.setup(
    name="surg_teleop",
    version="0.1.0",
    description="Hands on the controls of an arm, live and recorded",
    license="Apache-2.0",
    python_requires=">=3.11",
    packages=setuptools.find_packages("src"),
    package_dir={"": "src"},
    package_data={"surg_teleop": ["py.typed", "leaders/evdev/layouts/*.yaml"]},
    install_requires=[
        "evdev>=1.6",
        "numpy>=1.24",
        "pyyaml>=6.0",
        "scipy>=1.10",
    ],
)
