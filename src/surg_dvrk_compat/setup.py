"""Build of surg_dvrk_compat, read by catkin and by pip alike."""

import setuptools

setuptools.setup(
    name="surg_dvrk_compat",
    version="0.1.0",
    description="Topics that public dVRK clients insist on, each answered by a warning",
    license="Apache-2.0",
    python_requires=">=3.11",
    packages=["surg_dvrk_compat"],
    package_dir={"": "src"},
    package_data={"surg_dvrk_compat": ["py.typed"]},
)
