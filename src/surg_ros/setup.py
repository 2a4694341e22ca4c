"""Build of surg_ros, read by catkin."""

import setuptools

setuptools.setup(
    name="surg_ros",
    version="0.1.0",
    description="What every Python node needs: ports of an arm, lock-step, fast transport",
    license="Apache-2.0",
    python_requires=">=3.11",
    packages=["surg_ros"],
    package_dir={"": "src"},
    package_data={"surg_ros": ["py.typed"]},
    install_requires=["numpy>=1.24"],
)
