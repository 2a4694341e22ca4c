"""Build of surg_teleop, read by catkin and by pip alike."""

import setuptools

setuptools.setup(
    name="surg_teleop",
    version="0.1.0",
    description="Hands on the controls of an arm, live and recorded",
    license="Apache-2.0",
    python_requires=">=3.11",
    packages=["surg_teleop", "surg_teleop.console", "surg_teleop.leaders"],
    package_dir={"": "src"},
    package_data={"surg_teleop": ["py.typed"], "surg_teleop.console": ["page/*"]},
    install_requires=["numpy>=1.24", "scipy>=1.10"],
)
