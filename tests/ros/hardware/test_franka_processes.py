"""The links to Franka arms as processes, in real time, with the maker's own libraries.

Opt-in (`SURG_TEST_FULL=1`): the libraries get an environment of their own at the first run.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from helpers.graph.ros import RosGraph
from helpers.hardware import emulated_franka
from helpers.hardware.emulated_ur import mishap
from helpers.hardware.arm_graph import Graph, cell_at
from helpers.results import hardware_results as page
from surg_cli.host import paths
from surg_core import load_cell
from surg_msgs.msg import LinkStatus

pytestmark = pytest.mark.ros

SECONDS = float(os.environ.get("SURG_TEST_SECONDS", "60"))
OFF = 0.2
"""[mm] Largest deviation from the pivot beside other work of the machine; the chain has less."""
NOTHING = {"mass": 0.0, "cog": [0.0, 0.0, 0.0]}
KINDS = {"panda": "fer", "fr3": "fr3"}


def granted() -> bool:
    """Whether SCHED_FIFO is granted; figures without it say nothing of the link."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except OSError:
        return False
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return True


REAL_TIME = granted()


def play(rig: Graph) -> np.ndarray:
    """The bundled motion to its end; returns deviations from the pivot [mm]."""
    rig.start()
    operator = rig.operator(duration=SECONDS)
    rig.graph.wait_for(lambda: operator.exit_code is not None, SECONDS + 60.0, "the operator")
    said = rig.status.fault if rig.status else ""
    assert operator.exit_code == 0, operator.log_tail() + said + rig.link.log_tail()
    assert rig.condition == LinkStatus.ACTIVE, said
    assert np.ptp(np.array(rig.joints), axis=0).max() > 0.05, "nothing has moved"
    print(f"lag of the link: {1e3 * rig.lag:.2f} ms")
    return 1e3 * rig.deviations()


@pytest.mark.full
@pytest.mark.parametrize(("name", "loss"), [("panda", 0.0), ("panda", 0.002), ("fr3", 0.0)])
def test_the_bundled_motion_keeps_the_pivot_without_a_reflex(
    name: str, loss: float, ros_graph: RosGraph, rospy_node: str, tmp_path: Path
) -> None:
    home = load_cell(paths.CELLS / f"emulated_{name}").arms["PSM1"].robot.home
    at = [f"{angle:.6f}" for angle in home]
    with emulated_franka.program(KINDS[name], tmp_path / "log", "--q", *at) as address:
        rig = Graph(ros_graph, cell_at(name, tmp_path, address, NOTHING), REAL_TIME)
        assert mishap(address, f"loss {loss} commands") == "ok"
        deviation = play(rig)
        ros_graph.supervisor.stop()
    said = f"mean {deviation.mean():.4f} mm, max {deviation.max():.3f} mm, 0 reflexes"
    print(said)
    if SECONDS >= 60.0:
        page.note(page.franka(name, loss, "processes"), 1, f"{said}, {SECONDS:.0f} s")
    assert deviation.max() < (OFF if REAL_TIME else 0.5)
