"""A gateway on the test's graph, and processes that speak DDS beside it."""

from __future__ import annotations

import random
import subprocess
import sys
from collections.abc import Mapping

from helpers.graph.ros import RosGraph
from surg_cli.graph import topic_contract
from surg_cli.graph.processes import Child
from surg_cli.host import paths

PEER = paths.ROOT / "tests" / "helpers" / "ros2" / "peer.py"
DOMAINS = range(150, 230)
"""Of DDS; ROS 2 users take lower ones."""
POSE = "geometry_msgs/PoseStamped"
COMMAND = "/PSM1/servo_cp"


class Dds:
    """A domain of DDS for one test.

    Args:
        graph: The ROS 1 side.
    """

    def __init__(self, graph: RosGraph) -> None:
        self.graph = graph
        self.domain = random.SystemRandom().choice(DOMAINS)

    def gateway(
        self, name: str = "/ros2", env: dict[str, str] | None = None, **more: object
    ) -> Child:
        """Start a gateway; further parameters of the node."""
        params = {"contract": topic_contract.SOURCE, "domain": self.domain, "commands": True}
        return self.graph.node("surg_ros2", "ros2_gateway_node.py", name, {**params, **more}, env)

    def peer(
        self,
        name: str,
        data: str,
        *hear: str,
        label: str = "",
        kind: str = POSE,
        period: float = 0.05,
        domain: int | None = None,
        env: Mapping[str, str] | None = None,
    ) -> Child:
        """Start a process that sends commands, and hears; see ``peer``."""
        where = self.domain if domain is None else domain
        words = [sys.executable, PEER, where, name, COMMAND, kind, period, data, *hear]
        return self.graph.supervisor.start(
            f"peer{label or name}", [str(word) for word in words], extra_env=env
        )


def udp_sockets(pid: int) -> list[str]:
    """Where the UDP sockets of a process are open, as `address%interface:port`."""
    listed = subprocess.run(["ss", "-Hunap"], capture_output=True, text=True, check=True).stdout
    lines = [line for line in listed.splitlines() if f"pid={pid}," in line]
    return [line.split()[3] for line in lines]
