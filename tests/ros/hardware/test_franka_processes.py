"""The links to Franka arms as processes, in real time, with the maker's own libraries.

Opt-in (`SURG_TEST_FULL=1`): the libraries get an environment of their own at the first run.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from helpers.graph.ros import RosGraph
from helpers.hardware import client_venvs, emulated_franka
from helpers.hardware.arm_graph import REAL_TIME, ArmGraph
from helpers.hardware.emulated_cell import emulated_cell
from helpers.hardware.emulated_ur import fault
from helpers.hardware.other_fr3 import FRANKY_SIM
from helpers.hardware.other_fr3 import running as other_fr3
from helpers.results import hardware_results as page
from surg_cli.host import paths
from surg_core import load_cell
from surg_msgs.msg import LinkStatus

pytestmark = pytest.mark.ros

SECONDS = float(os.environ.get("SURG_TEST_SECONDS", "60"))
OFF = 0.2
"""[mm] Largest deviation from the pivot beside other work of the machine; the chain has less."""
NOTHING = {"mass": 0.0, "cog": [0.0, 0.0, 0.0]}
HAND = {"mass": 0.73, "cog": [-0.01, 0.0, 0.03]}
"""Payload of franky-sim's arm [kg, m]."""
KINDS = {"panda": "fer", "fr3": "fr3"}


def home(name: str) -> np.ndarray:
    """Home posture of the arm of a bundled cell [rad]."""
    return np.array(load_cell(paths.CELLS / f"emulated_{name}").arms["PSM1"].robot.home)


def play(rig: ArmGraph, seconds: float) -> np.ndarray:
    """The bundled motion to its end; returns deviations from the pivot [mm]."""
    rig.start()
    operator = rig.play(seconds)
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
    at = [f"{angle:.6f}" for angle in home(name)]
    with emulated_franka.program(KINDS[name], tmp_path / "log", "--q", *at) as address:
        rig = ArmGraph(ros_graph, emulated_cell(tmp_path, address, name, payload=NOTHING))
        assert fault(address, f"loss {loss} commands") == "ok"
        deviation = play(rig, SECONDS)
        ros_graph.supervisor.stop()
    said = f"mean {deviation.mean():.4f}, max {deviation.max():.3f} mm"
    print(said)
    if SECONDS >= 60.0:
        page.note(page.franka(name, loss, "processes"), 1, said)
    assert deviation.max() < (OFF if REAL_TIME else 0.5)


@pytest.mark.oracle
def test_the_bundled_motion_on_somebody_elses_fr3(
    ros_graph: RosGraph, rospy_node: str, tmp_path: Path
) -> None:
    """PyPI's franky-sim: a velocity controller of its own in MuJoCo.

    Judged while the motion is played: before it, the arm creeps off under commands of zero.
    """
    simulator = client_venvs.python(FRANKY_SIM)
    with other_fr3(simulator, tmp_path / "log", home("fr3")) as address:
        rig = ArmGraph(ros_graph, emulated_cell(tmp_path, address, "fr3", payload=HAND))
        deviation = play(rig, SECONDS)
        whole, deviation = deviation, deviation[np.array(rig.played)[: len(deviation)]]
        print(f"{len(deviation)} states; {whole.max():.3f} mm beside the motion")
        second = [deviation[k : k + 500].max() for k in range(0, len(deviation), 500)]
        print("largest of each second:", np.round(second, 3).tolist())
        ros_graph.supervisor.stop()
    said = f"mean {deviation.mean():.4f}, max {deviation.max():.3f} mm"
    print(said)
    if SECONDS >= 60.0:
        page.note(page.FRANKY, 1, said)
    assert deviation.max() <= 0.5
