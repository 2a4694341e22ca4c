"""Build of surg_console, read by catkin and by pip alike."""

import setuptools

setuptools.setup(
    name="surg_console",
    version="0.1.0",
    description="The operator's pages in the browser",
    license="Apache-2.0",
    python_requires=">=3.11",
    packages=setuptools.find_packages("src"),
    package_dir={"": "src"},
    package_data={"surg_console": ["py.typed"], "surg_console.web": ["page/*", "page/*/*"]},
    install_requires=["aiohttp>=3.8", "av>=10", "markupsafe>=2.1", "numpy>=1.24", "surg_recording"],
)
