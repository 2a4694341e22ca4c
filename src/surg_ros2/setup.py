"""Build of surg_ros2, read by catkin and by pip alike."""

import setuptools

setuptools.setup(
    name="surg_ros2",
    version="0.1.0",
    description="The graph's topics for ROS 2, over DDS and without an installation of ROS 2",
    license="Apache-2.0",
    python_requires=">=3.11",
    packages=["surg_ros2"],
    package_dir={"": "src"},
    package_data={"surg_ros2": ["py.typed"]},
)
