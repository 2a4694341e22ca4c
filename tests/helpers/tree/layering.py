"""Which package may use which: read from imports, includes, package.xml and CMake files."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

MESSAGES = frozenset({"crtk_msgs", "surg_msgs"})
FUNCTIONAL = frozenset(
    {
        "surg_control",
        "surg_sim",
        "surg_hardware",
        "surg_emulators",
        "surg_teleop",
        "surg_console",
        "surg_lambda7",
        "surg_perception",
        "surg_policy_bridge",
        "surg_dvrk_compat",
        "surg_ros2",
    }
)
LIBRARIES = frozenset({"surg_core", "surg_description", "surg_recording", "surg_ros"})
LEARNING = frozenset({"surg_learn"})
"""It trains in the simulator, so it stands above it, as the command line stands above all."""
PURE_IN_SURG_ROS = frozenset({"camera_topic", "link_messages", "params"})
"""Modules of surg_ros that need no ROS; everything else in it does."""
ALLOWED: dict[str, frozenset[str]] = {
    "crtk_msgs": frozenset(),
    "surg_msgs": frozenset(),
    "surg_core": frozenset(),
    "surg_description": frozenset({"surg_core"}),
    "surg_ros": MESSAGES | {"surg_core", "surg_description"},
    "surg_recording": MESSAGES | {"surg_core", "surg_ros"},
    **dict.fromkeys(FUNCTIONAL, MESSAGES | LIBRARIES),
    **dict.fromkeys(
        LEARNING, LIBRARIES - {"surg_ros"} | {"surg_sim", "surg_policy_bridge"}
    ),  # of the bridge: its client
    "surg_lerobot": frozenset({"surg_core", "surg_sim"}),
}
TOOLS = frozenset({"surg_cli"})
OURS = frozenset(ALLOWED) | TOOLS

CLI_FOLDERS = ("host", "graph", "robots", "learning", "commands")
"""Folders of surg_cli; each may use itself and those before it, but commands not one another."""

ROS_PYTHON = re.compile(
    r"^(rospy|roslib|roscpp|rosbag|rosgraph\w*|rosnode|rostopic|rosparam|rosmaster|genpy|genmsg|"
    r"tf|tf2_\w+|PyKDL|cv_bridge|nodelet\w*|std_srvs|\w+_msgs)$"
)
ROS_INCLUDE = re.compile(
    r"^(ros|tf2?|tf2_\w+|nodelet|pluginlib|kdl\w*|urdf\w*|urdf_\w+|class_loader|cv_bridge|\w+_msgs|"
    r"std_srvs)/"
)
SOURCES = {".c", ".cc", ".cpp", ".h", ".hpp", ".hh"}
SKIPPED = {"__pycache__", "build"}


@dataclass(frozen=True)
class Use:
    """One place where a file names another module.

    Attributes:
        package: Package the file belongs to.
        file: The file.
        line: Line number, 1 when the format has none.
        target: Imported module, included path, or dependency.
    """

    package: str
    file: Path
    line: int
    target: str


def violations(src: Path) -> list[str]:
    """Every arrow that points the wrong way in a tree of packages.

    Args:
        src: Folder with one folder per package.

    Returns:
        One sentence per violation, with file and line.
    """
    found = []
    for package in sorted(path.name for path in src.iterdir() if path.is_dir()):
        if package not in ALLOWED:
            found.append(f"{src / package}: a package that the layering does not know")
            continue
        for use in uses(src / package):
            top = re.split(r"[./]", use.target)[0]
            where = f"{use.file.relative_to(src)}:{use.line}"
            if top in OURS and top != package and top not in ALLOWED[package]:
                found.append(f"{where}: {package} must not use {top}")
            if top != package and needs_nodes(use):
                found.append(f"{where}: {package} must not use another package's nodes")
            if use.file.relative_to(src / package).parts[0] == "client" and top in OURS:
                found.append(f"{where}: a client must use nothing of ours but itself ({top})")
            if is_pure(use.file, src / package) and needs_ros(use):
                found.append(f"{where}: a core must not use ROS ({use.target})")
    return found


def cli_violations(root: Path) -> list[str]:
    """Every import inside surg_cli that points the wrong way.

    Args:
        root: The folder surg_cli.

    Returns:
        One sentence per violation, with file and line.
    """
    found = []
    for number, folder in enumerate(CLI_FOLDERS):
        allowed = CLI_FOLDERS[: number + (folder != "commands")]
        for file in sorted((root / folder).glob("*.py")):
            for line, target in _imports(file):
                parts = target.split(".")
                if parts[0] == "surg_cli" and parts[1] not in allowed:
                    found.append(f"{folder}/{file.name}:{line}: {folder} must not use {target}")
    return found


def is_pure(file: Path, package: Path) -> bool:
    """Whether a file belongs to a core.

    All of surg_core does, of surg_ros what `PURE_IN_SURG_ROS` names, and in the other packages
    every Python module but the nodes (`*_node.py`), the start scripts and the tests.

    Args:
        file: The file.
        package: Its package's folder.
    """
    if package.name == "surg_core":
        return file.name not in ("CMakeLists.txt", "package.xml")
    inside = file.relative_to(package).parts
    if file.suffix != ".py" or file.name == "setup.py":
        return False
    if package.name == "surg_ros":
        return file.stem in PURE_IN_SURG_ROS
    return not (file.name.endswith("_node.py") or {"scripts", "test", "tests"} & set(inside))


def needs_ros(use: Use) -> bool:
    """Whether what is used comes with ROS, is surg_ros, or is one of a package's own nodes."""
    if use.file.suffix == ".py":
        parts = use.target.split(".")
        if parts[0] == "surg_ros" != use.package:
            return not PURE_IN_SURG_ROS & set(parts[1:2])
        own_node = parts[0] in OURS and any(part.endswith("_node") for part in parts[1:])
        return bool(ROS_PYTHON.match(parts[0])) or own_node
    return bool(ROS_INCLUDE.match(use.target))


def needs_nodes(use: Use) -> bool:
    """Whether what is used is in the `nodes` folder of one of our packages."""
    parts = use.target.split(".")
    return use.file.suffix == ".py" and parts[0] in OURS and parts[1:2] == ["nodes"]


def uses(package: Path) -> Iterator[Use]:
    """Every import, include and dependency in a package."""
    for file in sorted(package.rglob("*")):
        inside = file.relative_to(package).parts
        if (
            not file.is_file()
            or SKIPPED & set(inside)
            or any(p.endswith("egg-info") for p in inside)
        ):
            continue
        if file.suffix in SOURCES:
            reader = _includes
        elif file.suffix == ".py":
            reader = _imports
        elif file.name == "package.xml":
            reader = _dependencies
        elif file.name == "CMakeLists.txt":
            reader = _components
        else:
            continue
        for line, target in reader(file):
            yield Use(package.name, file, line, target)


def _includes(file: Path) -> Iterator[tuple[int, str]]:
    """Targets of #include, with line numbers."""
    for number, line in enumerate(file.read_text("utf-8").splitlines(), 1):
        match = re.match(r'\s*#\s*include\s*[<"]([^">]+)[">]', line)
        if match:
            yield number, match.group(1)


def _imports(file: Path) -> Iterator[tuple[int, str]]:
    """Imported modules, at any depth of the file, with line numbers."""
    for node in ast.walk(ast.parse(file.read_text("utf-8"), str(file))):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            for alias in node.names:
                yield node.lineno, f"{node.module}.{alias.name}"
        elif isinstance(node, ast.Call) and node.args:
            called = node.func.attr if isinstance(node.func, ast.Attribute) else ""
            name = node.func.id if isinstance(node.func, ast.Name) else called
            first = node.args[0]
            if name in ("import_module", "__import__") and isinstance(first, ast.Constant):
                yield node.lineno, str(first.value)


def _dependencies(file: Path) -> Iterator[tuple[int, str]]:
    """Dependencies named in a package.xml."""
    for element in ElementTree.parse(file).getroot():
        if element.tag.endswith("depend") and element.text:
            yield 1, element.text.strip()


def _components(file: Path) -> Iterator[tuple[int, str]]:
    """Our own packages named in a find_package call."""
    text = file.read_text("utf-8")
    for call in re.finditer(r"find_package\s*\(([^)]*)\)", text):
        line = text.count("\n", 0, call.start()) + 1
        for word in call.group(1).split():
            if word in OURS:
                yield line, word
