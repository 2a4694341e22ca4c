"""One arm of the phantom in real time, with the teleoperation node that a program's hand drives."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from surg_cli.graph import master, system
from surg_cli.graph.processes import Child, Supervisor
from surg_cli.host import paths

CELL = paths.ROOT / "cells" / "sim_ur5e"


@contextmanager
def hand_system(
    logs: Path, out: Path, cameras: tuple[str, ...] = (), record: bool = True
) -> Iterator[Child]:
    """Run it with a ROS master of its own, to which this process belongs from now on.

    Args:
        logs: Folder for the logs.
        out: Folder for the recordings.
        cameras: The endoscope's, the first of which is the picture that the operator sees.
        record: Whether there is a recorder.

    Yields:
        The teleoperation node; its leader is the topic ``/hand/measured_cp``.
    """
    env = {**os.environ, "ROS_HOSTNAME": "localhost", "ROS_LOG_DIR": str(logs)}
    with Supervisor(env, logs) as supervisor:
        master.start(supervisor, master.free_port())
        os.environ.update(supervisor.env)
        plan = system.SystemPlan(
            cell=CELL, arms=("PSM1",), lockstep=False, cameras=cameras, out=out, record=record
        )
        params = {
            "cell": str(CELL),
            "leader": "crtk",
            "settings": {"name": "hand"},
            "scale": 1.0,
            "view": [0.0, 0.0, 0.0, 1.0],
            "picture": f"/endoscope/{cameras[0]}/image_raw" if cameras else "",
        }
        for node in system.nodes(plan):
            system.start(supervisor, node)
        teleop = system.Node("/teleop", "surg_teleop", "teleop_node.py", params)
        yield system.start(supervisor, teleop)
