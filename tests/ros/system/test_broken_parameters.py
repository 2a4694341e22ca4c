"""Every node in Python that may not run with its parameters ends with status 2 and says why.

Which values are refused is proved without processes, where the parameters are read; here each node
starts once or twice, all of them side by side.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from helpers.graph.ros import RosGraph
from surg_cli.host import paths

pytestmark = [pytest.mark.ros, pytest.mark.untimed]

CELL = {"cell": paths.CELLS / "sim_ur5e"}
TWO_ARMS = {"cell": paths.CELLS / "sim_two_arms"}
BROKEN: dict[str, tuple[str, str, dict[str, object], str]] = {
    "/bridge_arms": ("surg_sim", "bridge_node.py", {**CELL, "arms": ["PSM9"]}, "PSM9"),
    "/bridge_observers": (
        "surg_sim",
        "bridge_node.py",
        {**CELL, "observers": ["spectator"]},
        "spectator",
    ),
    "/bridge_faults": (
        "surg_sim",
        "bridge_node.py",
        {**CELL, "faults": '{"fault": "not_finite", "joint": 6}'},
        "0 to 5",
    ),
    "/bridge_task": ("surg_sim", "bridge_node.py", {**CELL, "task": "dance"}, "bgr"),
    "/bridge_setting": (
        "surg_sim",
        "bridge_node.py",
        {**TWO_ARMS, "task": "bgr", "setting": "space"},
        "phantom",
    ),
    "/endoscope": ("surg_sim", "endoscope_node.py", {**CELL, "width": 5000}, "~width"),
    "/recorder": (
        "surg_recording",
        "recorder_node",
        {"out": "/nowhere", "arms": []},
        "~arms",
    ),
    "/clock_sync": (
        "surg_recording",
        "clock_sync_node",
        {"rate": 0.0},
        "parameter ~rate is 0.0; allowed: a number",
    ),
    "/teleop": (
        "surg_teleop",
        "teleop_node",
        {**TWO_ARMS, "leader": "crtk", "scale": 5.0},
        "teleop: parameter ~scale is 5.0; allowed: a number from 0.01 to 1",
    ),
    "/operator": (
        "surg_teleop",
        "operator_node",
        {**CELL, "arm": "PSM7"},
        "~arm is 'PSM7'; allowed: the cell's arms: PSM1",
    ),
    "/leader": ("surg_teleop", "leader_node", {"leader": "teapot"}, "there is no such leader"),
    "/console": (
        "surg_console",
        "console_node.py",
        {**CELL, "bind": "192.168.1.1"},
        "TLS and a token",
    ),
    "/eyes": ("surg_perception", "stereo_depth_node.py", {"method": "census"}, "census"),
    "/dvrk_compat": ("surg_dvrk_compat", "dvrk_compat_node.py", {"arms": 3}, "_arms:=PSM1"),
}
"""Package, program, parameters and words of the refusal, by the node's name."""


def test_a_broken_parameter_ends_a_node_with_2_and_its_reason(
    ros_graph: RosGraph, rospy_node: str, tmp_path: Path
) -> None:
    nodes = {
        name: ros_graph.node(package, program, name, params)
        for name, (package, program, params, _) in BROKEN.items()
    }
    for name, node in nodes.items():
        ros_graph.wait_for(lambda n=node: n.exit_code is not None, 60.0, f"the end of {name}")
    told = {name: (node.exit_code, node.log_tail(20)) for name, node in nodes.items()}
    wrong = {
        name: said for name, said in told.items() if said[0] != 2 or BROKEN[name][3] not in said[1]
    }
    assert wrong == {}
