"""Build of surg_perception, read by catkin."""

import setuptools

setuptools.setup(
    name="surg_perception",
    version="0.1.0",
    description="Capture and calibration of endoscopes",
    license="Apache-2.0",
    python_requires=">=3.11",
    packages=setuptools.find_packages("src"),
    package_dir={"": "src"},
    package_data={"surg_perception": ["py.typed"]},
    install_requires=["numpy>=1.24", "scipy>=1.10"],
)
