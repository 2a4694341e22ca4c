"""`./surg teleop`: which nodes it would start, with which parameters."""

from __future__ import annotations

import argparse

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import surg_core
from surg_cli import paths, teleop
from surg_cli.terminal import Problem
from surg_sim import tasks
from surg_sim.world import World
from surg_teleop.system import read_system


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
    hands, page = teleop._operator_nodes(chosen, plan, {"port": 8090}, [])
    assert hands.params["leader"] == "crtk" and hands.params["settings"] == {"name": "browser"}
    assert hands.params["need_present"] is True and "view" not in hands.params
    assert page.params["views"] == ["left", "right"] and page.params["port"] == 8090
    assert page.params["episodes"] == str(plan.out / "episode")


def test_one_arm_has_no_task_and_a_camera_that_stands() -> None:
    chosen = options("sim_ur5e", "--leader", "gamepad")
    plan = teleop._plan(chosen)
    assert plan.task == "" and "endless" not in teleop._phantom(plan)[0].params
    hands, page = teleop._operator_nodes(chosen, plan, {}, [])
    assert hands.params["leader"] == "gamepad" and "settings" not in hands.params
    assert page.params["leader"] == ""  # the page shows and enables, the gamepad moves
    view = np.array(hands.params["view"])
    assert np.linalg.norm(view) == pytest.approx(1.0)
    R_WV = Rotation.from_quat(view).as_matrix()
    # It looks down into the patient with its picture upright: y down, z away and down.
    assert R_WV[2, 2] < -0.3 and R_WV[2, 1] < -0.3 and abs(R_WV[2, 0]) < 1e-6


def test_a_second_hand_holds_the_assistants_instrument() -> None:
    chosen = options("--second-leader", "gamepad")
    hands, _ = teleop._operator_nodes(chosen, teleop._plan(chosen), {}, [])
    assert hands.params["second_leader"] == "gamepad"
    assert hands.params["second_arm"] == "assistant"
    # The oracle is the task's own state.
    world = World(surg_core.load_cell(paths.CELLS / "sim_two_arms"), 3, task=tasks.load("bgr"))
    R = Rotation.from_quat(hands.params["assistant_frame"]).as_matrix()
    assert pytest.approx(R, abs=1e-12) == world.task.state()["X_WAssistant"][:3, :3]
    system = read_system({**hands.params, "cell": str(paths.CELLS / "sim_two_arms")}, "/teleop")
    assert [set(hand.seat.arms) for hand in system.hands] == [{"PSM1", "ECM"}, {"assistant"}]


@pytest.mark.parametrize(
    "words", [("--task", "none"), ("--task", "endoscope_guidance"), ("sim_ur5e",)]
)
def test_a_second_hand_without_an_assistant_is_refused(words: tuple[str, ...]) -> None:
    chosen = options(*words, "--second-leader", "gamepad")
    with pytest.raises(Problem, match="has no assistant's instrument for a second hand"):
        teleop._operator_nodes(chosen, teleop._plan(chosen), {}, [])


def test_beside_a_teleoperation_that_runs_only_the_page_is_started() -> None:
    chosen = options("sim_ur5e")
    (page,) = teleop._operator_nodes(chosen, teleop._plan(chosen), {}, ["/sim", "/teleop"])
    assert page.name == "/console" and page.params["leader"] == ""
    chosen = options("sim_ur5e", "--leader", "gamepad")
    with pytest.raises(Problem, match="a teleoperation runs already, with leaders of its own"):
        teleop._operator_nodes(chosen, teleop._plan(chosen), {}, ["/teleop"])


def test_what_cannot_be_meant_is_refused() -> None:
    with pytest.raises(Problem, match="no cell 'nowhere'"):
        teleop._plan(options("nowhere"))
    with pytest.raises(Problem, match="no task 'bowel': there are bgr"):
        teleop._plan(options("--task", "bowel"))
    with pytest.raises(Problem, match="'lunar'"):
        teleop._plan(options("--setting", "lunar"))
    with pytest.raises(Problem, match="anybody on the network"):
        teleop._web(options("--bind", "0.0.0.0"))
    with pytest.raises(Problem, match="belong together"):
        teleop._web(options("--cert", "/nowhere.pem"))
