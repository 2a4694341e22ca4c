"""Build of surg_emulators, read by catkin and by pip alike."""

import setuptools

setuptools.setup(
    name="surg_emulators",
    version="0.1.0",
    description="Emulated controllers of UR and Franka arms",
    license="Apache-2.0",
    python_requires=">=3.11",
    packages=setuptools.find_packages("src"),
    package_dir={"": "src"},
    package_data={"surg_emulators": ["py.typed"]},
    install_requires=["lark>=1.1.5", "numpy>=1.24", "scipy>=1.10"],
)
