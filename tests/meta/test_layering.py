"""Nobody imports against the layering, and the check that says so notices when somebody does."""

from pathlib import Path

import pytest

from helpers.tree.layering import CLI_FOLDERS, cli_violations, violations
from surg_cli.host import paths


def test_layering_holds() -> None:
    assert violations(paths.ROOT / "src") == []


def test_layers_of_the_command_line_hold() -> None:
    root = paths.ROOT / "tools" / "surg_cli"
    folders = {path.parent.name for path in root.glob("*/*.py")}
    assert folders == set(CLI_FOLDERS)
    assert cli_violations(root) == []


@pytest.mark.parametrize(
    ("file", "line"),
    [
        ("host/paths.py", "from surg_cli.graph import master"),
        ("graph/watch.py", "def f():\n    from surg_cli.commands import run"),
        ("graph/watch.py", "from surg_cli.__main__ import run"),
        ("learning/rollouts.py", "import surg_cli.commands.run"),
        ("commands/demo.py", "from surg_cli.commands.run import main"),
    ],
)
def test_a_wrong_import_in_the_command_line_is_noticed(
    file: str, line: str, tmp_path: Path
) -> None:
    assert cli_violations(write(tmp_path, "graph/good.py", "from surg_cli.host import paths")) == []
    assert len(cli_violations(write(tmp_path, file, line))) == 1


def write(root: Path, name: str, text: str) -> Path:
    path = root / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return root


def test_a_clean_tree_passes(tmp_path: Path) -> None:
    write(tmp_path, "surg_sim/src/surg_sim/arm.py", "import numpy\nimport surg_core\n")
    write(tmp_path, "surg_sim/src/surg_sim/bridge_node.py", "import rospy\nimport surg_msgs.msg\n")
    write(tmp_path, "surg_ros/src/surg_ros/arm_port.py", "import rospy\nimport surg_msgs.msg\n")
    write(tmp_path, "surg_sim/src/surg_sim/settings.py", "from surg_ros.params import Params\n")
    write(tmp_path, "surg_core/src/rcm.cpp", "#include <Eigen/Dense>\n#include <vector>\n")
    write(tmp_path, "surg_core/include/surg_core/rcm.hpp", '#include "surg_core/types.hpp"\n')
    write(tmp_path, "surg_control/src/a.cpp", "#include <ros/ros.h>\n#include <surg_core/a.hpp>\n")
    assert violations(tmp_path) == []


BROKEN = {
    "one functional package imports another": (
        "surg_sim/src/surg_sim/bridge_node.py",
        "from surg_teleop.playback.motion_file import Motion\n",
        "surg_sim must not use surg_teleop",
    ),
    "an import inside a function": (
        "surg_teleop/src/surg_teleop/a_node.py",
        "def f():\n    import surg_sim\n",
        "surg_teleop must not use surg_sim",
    ),
    "an import by name": (
        "surg_teleop/src/surg_teleop/a_node.py",
        "import importlib\nimportlib.import_module('surg_sim.physics.sim_arm')\n",
        "surg_teleop must not use surg_sim",
    ),
    "an include": (
        "surg_hardware/src/link.cpp",
        "#include <surg_control/options.hpp>\n",
        "surg_hardware must not use surg_control",
    ),
    "a dependency in package.xml": (
        "surg_control/package.xml",
        "<package><depend>surg_sim</depend></package>",
        "surg_control must not use surg_sim",
    ),
    "a dependency in CMake": (
        "surg_control/CMakeLists.txt",
        "find_package(catkin REQUIRED COMPONENTS\n  roscpp surg_sim)\n",
        "surg_control must not use surg_sim",
    ),
    "the core includes ROS": (
        "surg_core/src/rcm.cpp",
        "#include <ros/time.h>\n",
        "a core must not use ROS (ros/time.h)",
    ),
    "the core includes messages": (
        "surg_core/include/surg_core/rcm.hpp",
        "#include <geometry_msgs/Pose.h>\n",
        "a core must not use ROS (geometry_msgs/Pose.h)",
    ),
    "the core includes KDL": (
        "surg_core/src/kinematics.cpp",
        "#include <kdl/chain.hpp>\n",
        "a core must not use ROS (kdl/chain.hpp)",
    ),
    "the core's Python imports ROS": (
        "surg_core/python/surg_core/config.py",
        "import rospy\n",
        "a core must not use ROS (rospy)",
    ),
    "a pure module imports ROS": (
        "surg_recording/src/surg_recording/metrics.py",
        "def f():\n    from surg_msgs.msg import Cycle\n",
        "a core must not use ROS (surg_msgs.msg.Cycle)",
    ),
    "a pure module imports a node": (
        "surg_sim/src/surg_sim/arm.py",
        "from surg_sim.nodes import bridge_node\n",
        "a core must not use ROS (surg_sim.nodes.bridge_node)",
    ),
    "a library imports a functional package": (
        "surg_recording/src/surg_recording/report.py",
        "import surg_sim\n",
        "surg_recording must not use surg_sim",
    ),
    "a functional package imports the learning": (
        "surg_sim/src/surg_sim/a_node.py",
        "from surg_learn import recipes\n",
        "surg_sim must not use surg_learn",
    ),
    "the learning imports a package beside the simulator": (
        "surg_learn/src/surg_learn/recipes.py",
        "import surg_teleop\n",
        "surg_learn must not use surg_teleop",
    ),
    "somebody imports the command line": (
        "surg_sim/src/surg_sim/a_node.py",
        "from surg_cli import paths\n",
        "surg_sim must not use surg_cli",
    ),
    "the policies' client uses something of ours": (
        "surg_policy_bridge/client/src/surg_policy_client/link.py",
        "def f():\n    from surg_core import Gate\n",
        "a client must use nothing of ours but itself (surg_core)",
    ),
    "a functional package takes ROS plumbing from the recorder": (
        "surg_teleop/src/surg_teleop/a_node.py",
        "from surg_recording.nodes.recorder_node import main\n",
        "surg_teleop must not use another package's nodes",
    ),
    "surg_ros imports the recorder": (
        "surg_ros/src/surg_ros/arm_port.py",
        "import surg_recording\n",
        "surg_ros must not use surg_recording",
    ),
    "a pure module of surg_ros imports ROS": (
        "surg_ros/src/surg_ros/params.py",
        "import rospy\n",
        "a core must not use ROS (rospy)",
    ),
    "a core imports the ROS library": (
        "surg_recording/src/surg_recording/metrics.py",
        "from surg_ros.byte_topics import BytesPublisher\n",
        "a core must not use ROS (surg_ros.byte_topics.BytesPublisher)",
    ),
    "an unknown package": ("surg_more/a.py", "", "a package that the layering does not know"),
}


@pytest.mark.parametrize("what", BROKEN)
def test_a_broken_tree_is_noticed(what: str, tmp_path: Path) -> None:
    file, text, said = BROKEN[what]
    found = violations(write(tmp_path, file, text))
    assert len(found) == 1, found
    assert said in found[0]
