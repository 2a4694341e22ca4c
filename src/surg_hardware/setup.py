"""Build of surg_hardware, read by catkin."""

import setuptools

setuptools.setup(
    name="surg_hardware",
    version="0.1.0",
    description="Links to real robot arms",
    license="Apache-2.0",
    python_requires=">=3.11",
    packages=setuptools.find_packages("src"),
    package_dir={"": "src"},
    package_data={"surg_hardware": ["py.typed", "franka/packages.lock"]},
    install_requires=["numpy>=1.24"],
)
