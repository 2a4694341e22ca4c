"""Build of surg_recording, read by catkin and by pip alike."""

import setuptools

setuptools.setup(
    name="surg_recording",
    version="0.1.0",
    description="Episode folders: recording, metrics, figures and reports",
    license="Apache-2.0",
    python_requires=">=3.11",
    packages=["surg_recording", "surg_recording.metrics"],
    package_dir={"": "src"},
    package_data={"surg_recording": ["py.typed", "view.html", "view.css", "view.js"]},
    install_requires=[
        "numpy>=1.24",
        "scipy>=1.10",
        "matplotlib>=3.6",
        "pyyaml>=6",
        "av>=10",
        "pillow>=9",
    ],
)
