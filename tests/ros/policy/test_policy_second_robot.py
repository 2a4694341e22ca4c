"""One policy process drives the simulated UR5e, then a robot it has never heard of."""

from __future__ import annotations

import signal
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import rospy
import yaml
from sensor_msgs.msg import JointState

from helpers.control import panda_link
from helpers.control.dh import panda
from helpers.graph.ros import RosGraph
from helpers.policy.policy_rig import PolicyRig
from helpers.results.policy_results import note
from surg_cli.graph.processes import wait_until
from surg_cli.host import paths
from surg_description.make_cell import make_cell

DESCRIPTION = paths.ROOT / "src" / "surg_description"


def write_cell(folder: Path) -> Path:
    """A cell round a Panda that takes a flange twist, as docs/guide/adding_a_robot.md says."""
    robot = yaml.safe_load((DESCRIPTION / "robots" / "panda.yaml").read_text("utf-8"))
    robot["urdf"] = str(DESCRIPTION / "urdf" / "panda.urdf")
    robot["command"] = "cartesian_velocity"
    written = folder / "panda.yaml"
    written.write_text(yaml.safe_dump(robot, sort_keys=False), "utf-8")
    cell = make_cell(written, folder / "cell", DESCRIPTION / "instruments" / "grasper.yaml")
    (cell.parent / "own.yaml").write_text(
        "format: surg_link/1\nname: own\nlink_timeout: 0.1\nlink_lag: 0.004\nacceleration: 1.0\n"
    )
    cell.write_text(cell.read_text("utf-8").replace("link: simulator", "link: own.yaml"))
    return cell.parent


def test_the_links_own_kinematics() -> None:
    """Its Jacobian against differences of the published forward kinematics, 200 postures."""
    rng = np.random.default_rng(5)
    worst = 0.0
    for _ in range(200):
        q = panda_link.HOME + rng.uniform(-0.5, 0.5, 7)
        J = panda_link.jacobian(q)
        for joint in range(7):
            step = np.zeros(7)
            step[joint] = 1e-6
            linear = (panda(q + step)[:3, 3] - panda(q - step)[:3, 3]) / 2e-6
            worst = max(worst, float(np.abs(J[:3, joint] - linear).max()))
            R = panda(q + step)[:3, :3] @ panda(q - step)[:3, :3].T
            turn = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 4e-6
            worst = max(worst, float(np.abs(J[3:, joint] - turn).max()))
        twist = rng.uniform(-0.05, 0.05, 6)
        np.testing.assert_allclose(J @ panda_link.joint_velocities(q, twist), twist, atol=1e-4)
    print(f"worst difference {worst:.1e}")
    assert worst < 1e-6


@pytest.mark.ros
@pytest.mark.full
def test_the_same_client_process_drives_a_second_robot(
    ros_graph: RosGraph, rospy_node: str, tmp_path: Path
) -> None:
    first = PolicyRig(ros_graph)
    client = first.policy("client")
    first.run()
    steps = len(first.actions)
    wait_until(lambda: len(first.actions) > steps + 30, 10.0)
    assert not first.rejected
    kept = [child for child in ros_graph.supervisor.children if child is not client]
    ros_graph.supervisor.stop(kept)
    first.close()

    cell = write_cell(tmp_path)

    def nodes(graph: RosGraph) -> None:
        script = [sys.executable, "-s", panda_link.__file__, "__name:=panda_link"]
        graph.supervisor.start("/panda_link", script)
        params = {"cell": cell, "arm": "PSM1", "mode": "freerun"}
        graph.node("surg_control", "rcm_node", "/PSM1/controller", params)

    rig = PolicyRig(ros_graph, cell, nodes, first.address)
    joints: list[tuple[float, np.ndarray]] = []
    ear = rospy.Subscriber(
        "/PSM1/robot/measured_js",
        JointState,
        lambda m: joints.append((time.monotonic(), np.array(m.velocity))),
    )
    rig.run()
    begin = len(rig.cycles)
    steps = len(rig.actions)
    assert wait_until(lambda: len(rig.actions) > steps + 40, 15.0), rig.status
    path = np.array([seen.p_tip for seen in rig.cycles[begin:]])
    worst = max(seen.rcm_error for seen in rig.cycles[begin:])
    reach = float(np.linalg.norm(path.max(axis=0) - path.min(axis=0)))
    pivot = f"pivot kept within {1e6 * worst:.0f} um"
    note(8, 1, f"UR5e, then a kinematic Panda: {1e3 * reach:.0f} mm across, {pivot}")
    assert client.exit_code is None, "the same process"
    assert not rig.rejected and reach > 0.02 and worst < 1e-3

    # The link's own dead-man: the controller is frozen while the arm moves.
    children = ros_graph.supervisor.children
    controller = [child for child in children if child.name == "/PSM1/controller"][-1]
    assert np.abs(joints[-1][1]).max() > 1e-2
    controller.send(signal.SIGSTOP)
    moment = time.monotonic()
    assert wait_until(lambda: not np.any(joints[-1][1]), 3.0)
    took = next(at for at, qd in joints if at > moment and not np.any(qd)) - moment
    controller.send(signal.SIGCONT)
    print(f"frozen controller: the link stopped by itself after {1e3 * took:.0f} ms")
    assert took < panda_link.DEAD_MAN + 0.15
    ear.unregister()
    rig.close()
