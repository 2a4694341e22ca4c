"""Build of surg_policy_bridge with the client library beside it, read by catkin.

The client is a pip project of its own (client/pyproject.toml) for machines without ROS; here both
sides of the wire come from one checkout, so that there is one codec.
"""

import setuptools

setuptools.setup(
    name="surg_policy_bridge",
    version="0.1.0",
    description="Learned policies on the arms: model server and safety controller",
    license="Apache-2.0",
    python_requires=">=3.11",
    packages=[
        "surg_policy_bridge",
        "surg_policy_bridge.nodes",
        "surg_policy_bridge.server",
        "surg_policy_client",
    ],
    package_dir={
        "surg_policy_bridge": "src/surg_policy_bridge",
        "surg_policy_client": "client/src/surg_policy_client",
    },
    package_data={"surg_policy_bridge": ["py.typed"], "surg_policy_client": ["py.typed"]},
    install_requires=["msgpack>=1.0", "numpy>=1.20", "pyzmq>=22"],
)
