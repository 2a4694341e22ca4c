"""Packaging of surg_sim, read by catkin (catkin_python_setup) and by pip alike."""

from setuptools import setup

setup(
    name="surg_sim",
    version="0.1.0",
    description="MuJoCo phantom of the surgical-robotics platform: arms, trocars, endoscope",
    license="Apache-2.0",
    packages=["surg_sim"],
    package_dir={"": "src"},
    package_data={"surg_sim": ["assets/*.xml", "py.typed"]},
    python_requires=">=3.11",
    install_requires=["numpy", "mujoco>=4.0,<4.1", "surg_core"],
)
