"""Build of surg_recording, read by catkin and by pip alike."""

import setuptools

setuptools.setup(
    name="surg_recording",
    version="0.1.0",
    description="Episode folders: recording, metrics, figures and reports",
    license="Apache-2.0",
    python_requires=">=3.11",
    packages=setuptools.find_packages("src"),
    package_dir={"": "src"},
    package_data={
        "surg_recording": ["py.typed", "reports/templates/*", "datasets/pages/templates/*"]
    },
    install_requires=[
        "numpy>=1.24",
        "scipy>=1.10",
        "jinja2>=3.1",
        "markupsafe>=2.1",
        "matplotlib>=3.6",
        "pyyaml>=6",
        "av>=10",
        "pillow>=9",
        "surg_core",
    ],
    # Dataset formats (surg_recording.datasets); pyarrow 26 asks for a numpy newer than Debian's.
    extras_require={
        "lerobot": ["pyarrow>=15,<26"],
        "hdf5": ["h5py>=3.7"],
        "mcap": ["mcap>=1.2,<2"],
        "bags": ["rosbags>=0.10.11,<0.12"],
        "zarr": ["zarr>=2.13,<3"],
        "dask": ["distributed>=2022.12"],
    },
)
