"""`./surg teleop`: which nodes it would start, with which parameters."""

from __future__ import annotations

import argparse

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from surg_cli import teleop
from surg_cli.terminal import Problem


def options(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    teleop.add_arguments(parser, "teleop")
    return parser.parse_args(words)


def test_two_arms_have_a_task_that_does_not_end() -> None:
    chosen = options("--stereo")
    plan = teleop._plan(chosen)
    assert (plan.task, plan.setting, plan.cameras) == ("bgr", "phantom", ("left", "right"))
    nodes = {node.name: node for node in teleop._phantom(plan)}
    assert nodes["/sim"].params["endless"] is True
    assert {"/endoscope", "/PSM1/controller", "/ECM/controller", "/recorder"} <= set(nodes)
    hands, page = teleop._operator_nodes(chosen, plan, {"port": 8090})
    assert hands.params["leader"] == "crtk" and hands.params["settings"] == {"name": "browser"}
    assert hands.params["need_present"] is True and "view" not in hands.params
    assert page.params["views"] == ["left", "right"] and page.params["port"] == 8090
    assert page.params["episodes"] == str(plan.out / "episode")


def test_one_arm_has_no_task_and_a_camera_that_stands() -> None:
    chosen = options("sim_ur5e", "--leader", "gamepad")
    plan = teleop._plan(chosen)
    assert plan.task == "" and "endless" not in teleop._phantom(plan)[0].params
    hands, page = teleop._operator_nodes(chosen, plan, {})
    assert hands.params["leader"] == "gamepad" and "settings" not in hands.params
    assert page.params["leader"] == ""  # the page shows and enables, the gamepad moves
    view = np.array(hands.params["view"])
    assert np.linalg.norm(view) == pytest.approx(1.0)
    R_WV = Rotation.from_quat(view).as_matrix()
    # It looks down into the patient with its picture upright: y down, z away and down.
    assert R_WV[2, 2] < -0.3 and R_WV[2, 1] < -0.3 and abs(R_WV[2, 0]) < 1e-6


def test_what_cannot_be_meant_is_refused() -> None:
    with pytest.raises(Problem, match="no cell 'nowhere'"):
        teleop._plan(options("nowhere"))
    with pytest.raises(Problem, match="anybody on the network"):
        teleop._web(options("--bind", "0.0.0.0"))
    with pytest.raises(Problem, match="belong together"):
        teleop._web(options("--cert", "/nowhere.pem"))
