"""Build of surg_learn, read by catkin and by pip alike."""

import setuptools

setuptools.setup(
    name="surg_learn",
    version="0.1.0",
    description="Learned policies: demonstrations, data set, training, policies that are served",
    license="Apache-2.0",
    python_requires=">=3.11",
    packages=setuptools.find_packages("src"),
    package_dir={"": "src"},
    package_data={"surg_learn": ["py.typed"]},
    install_requires=["numpy>=1.24"],
    extras_require={
        "chain": ["surg_policy_bridge", "surg_recording[lerobot]", "surg_sim[gym]"],
        "torch": ["torch"],
    },
)
