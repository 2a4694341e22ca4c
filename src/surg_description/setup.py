"""Build of surg_description, read by catkin and by pip alike."""

import setuptools

setuptools.setup(
    name="surg_description",
    version="0.1.0",
    description="Robots and instruments as plain URDF and YAML, and the generator of cells",
    license="Apache-2.0",
    python_requires=">=3.11",
    packages=["surg_description"],
    package_dir={"": "src"},
    package_data={"surg_description": ["py.typed"]},
    install_requires=["numpy>=1.24", "pyyaml>=6", "surg_core"],
)
