"""`./surg teleop`: which nodes it would start, with which parameters."""

from __future__ import annotations

import functools
import json
import socket
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import surg_core
from helpers.graph.surg import parsed
from helpers.sim.assistant_pose import forward
from surg_cli.commands import teleop
from surg_cli.graph import master
from surg_cli.graph.processes import Supervisor
from surg_cli.host import paths
from surg_cli.host.terminal import CliError
from surg_console.ros.console_node import Settings
from surg_core.hand.leader_sample import HandRate, LeaderSample
from surg_sim import tasks
from surg_sim.physics.assistant_arm import AssistantCommand
from surg_sim.physics.world import World
from surg_teleop.follow.teleop_setup import read_setup
from surg_teleop.follow.teleop_types import CameraView

options = functools.partial(parsed, "teleop")


def test_two_arms_have_a_task_that_does_not_end() -> None:
    chosen = options("--cameras", "stereo")
    plan = teleop._plan(chosen)
    assert (plan.task, plan.setting, plan.cameras) == ("bgr", "phantom", ("left", "right"))
    nodes = {node.name: node for node in teleop._phantom(plan)}
    assert nodes["/sim"].params["endless"] is True
    assert {"/endoscope", "/PSM1/controller", "/ECM/controller", "/recorder"} <= set(nodes)
    assistant, hands, page = teleop._operator_nodes(chosen, plan, {"port": 8090}, [])
    assert (assistant.name, assistant.params["after"]) == ("/assistant", ["PSM1"])
    assert (
        "Wait until the assistant points" in json.loads(page.params["language"])["stages"]["point"]
    )
    alone = teleop._operator_nodes(chosen, plan, {"port": 8090}, ["/assistant"])
    assert [node.name for node in alone] == ["/teleop", "/console"], "one runs already"
    second = teleop._operator_nodes(
        options("--leader", "browser", "--leader", "gamepad"), plan, {"port": 8090}, []
    )
    assert [node.name for node in second] == ["/teleop", "/console"], "a person assists"
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
    # The page shows and enables, the gamepad moves; the nodes themselves read it so.
    assert Settings(page.params).leader == "" == page.params["leader"]
    assert read_setup(hands.params, "/teleop").hands[0].leader.name == "gamepad"
    view = np.array(hands.params["view"])
    assert np.linalg.norm(view) == pytest.approx(1.0)
    R_WV = Rotation.from_quat(view).as_matrix()
    # It looks down into the patient with its picture upright: y down, z away and down.
    assert R_WV[2, 2] < -0.3 and R_WV[2, 1] < -0.3 and abs(R_WV[2, 0]) < 1e-6


def test_the_token_is_for_the_terminal_only(tmp_path: Path) -> None:
    """What a node prints is in a log that others may read."""
    token = tmp_path / "token"
    token.write_text("0123456789abcdef\n")
    token.chmod(0o600)
    port = str(master.free_port())
    params, fragment = teleop._web(
        options("--token-file", str(token), "--bind", f"127.0.0.1:{port}")
    )
    assert fragment == "#token=0123456789abcdef"
    assert (
        params["token_file"] == str(token)
        and "0123" not in Settings({"cell": str(paths.CELLS / "sim_ur5e"), **params}).access.url
    )


def test_a_second_hand_holds_the_assistants_instrument() -> None:
    chosen = options("--leader", "browser", "--leader", "gamepad")
    hands, _ = teleop._operator_nodes(chosen, teleop._plan(chosen), {}, [])
    assert hands.params["second_leader"] == "gamepad"
    assert hands.params["second_arm"] == "assistant"
    # The oracle is the task's own state.
    world = World(surg_core.load_cell(paths.CELLS / "sim_two_arms"), 3, task=tasks.load("bgr"))
    R = Rotation.from_quat(hands.params["assistant_frame"]).as_matrix()
    assert pytest.approx(R, abs=1e-12) == world.task.state()["X_WAssistant"][:3, :3]
    system = read_setup({**hands.params, "cell": str(paths.CELLS / "sim_two_arms")}, "/teleop")
    assert [set(hand.switch.arms) for hand in system.hands] == [{"PSM1", "ECM"}, {"assistant"}]


def test_the_second_hand_moves_its_tip_as_the_picture_shows_it() -> None:
    """The simulator's instrument, the system of the command's parameters, a stick up for 1 s."""
    chosen = options("--leader", "browser", "--leader", "crtk")
    hands, _ = teleop._operator_nodes(chosen, teleop._plan(chosen), {}, [])
    cell = surg_core.load_cell(paths.CELLS / "sim_two_arms")
    params = {**hands.params, "second_settings": {"name": "second"}, "second_mapping": "rate"}
    system = read_setup(params, "/teleop")
    world = World(cell, 0, task=tasks.load("bgr"))
    arm, seat, instrument = system.assistant, system.hands[1].switch, world.task.assistant
    camera = CameraView(system.camera.rotation(np.array(cell.arms["ECM"].robot.home)))
    R_VA = camera.R_WV.T @ arm.R_WR
    seat.enable()
    start = R_VA @ forward(instrument.joints)[:3, 3]
    for k in range(1000):
        now = k * 0.002
        arm.joints(now, 0, instrument.joints)
        stick = np.array([0.0, -0.02, 0.0]) if 250 <= k < 750 else np.zeros(3)
        sample = LeaderSample(now, rate=HandRate(stick))
        commands = seat.tick(now, sample, {"assistant": arm.view()}, camera)["assistant"].commands
        asked = arm.convert(commands)
        world.step({}, AssistantCommand(asked.servo_jp, asked.jaw))
    way = R_VA @ forward(instrument.joints)[:3, 3] - start
    print(f"a stick up for 1 s at 20 mm/s: {np.round(1e3 * way, 2)} mm right, down, away")
    assert way == pytest.approx([0.0, -0.02, 0.0], abs=1e-3)


@pytest.mark.parametrize(
    "words", [("--task", "none"), ("--task", "endoscope_guidance"), ("sim_ur5e",)]
)
def test_a_second_hand_without_an_assistant_is_refused(words: tuple[str, ...]) -> None:
    chosen = options(*words, "--leader", "browser", "--leader", "gamepad")
    with pytest.raises(CliError, match="has no assistant's instrument for a second hand"):
        teleop._operator_nodes(chosen, teleop._plan(chosen), {}, [])


def test_beside_a_teleoperation_that_runs_only_the_page_is_started() -> None:
    chosen = options("sim_ur5e")
    (page,) = teleop._operator_nodes(chosen, teleop._plan(chosen), {}, ["/sim", "/teleop"])
    assert page.name == "/console" and page.params["leader"] == ""
    chosen = options("sim_ur5e", "--leader", "gamepad")
    with pytest.raises(CliError, match="--leader"):
        teleop._operator_nodes(chosen, teleop._plan(chosen), {}, ["/teleop"])


def test_a_taken_port_is_refused_before_anything_starts(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken, Supervisor({}, tmp_path) as supervisor:
        port = taken.getsockname()[1]
        with pytest.raises(CliError, match=r"in use .*--bind") as page:
            teleop._web(options("--bind", f"127.0.0.1:{port}"))
        with pytest.raises(CliError, match=r"in use .*--port") as ros:
            master.start(supervisor, port)
        assert (page.value.code, ros.value.code, supervisor.children) == (2, 2, [])


def test_unusable_options_are_refused() -> None:
    with pytest.raises(CliError, match="no cell 'nowhere'"):
        teleop._plan(options("nowhere"))
    with pytest.raises(CliError, match=r"bowel: .*there are bgr"):
        teleop._plan(options("--task", "bowel"))
    with pytest.raises(CliError, match="'lunar'"):
        teleop._plan(options("--setting", "lunar"))
    with pytest.raises(CliError, match="TLS"):
        teleop._web(options("--bind", "0.0.0.0"))
    with pytest.raises(CliError, match=r"certificate /nowhere\.pem: no such file"):
        teleop._web(options("--tls", "/nowhere.pem", "/nowhere.key"))
    chosen = options("--leader", "browser", "--leader", "crtk", "--leader", "gamepad")
    with pytest.raises(CliError, match="--leader gamepad: two leaders at most"):
        teleop._operator_nodes(chosen, teleop._plan(chosen), {}, [])


@pytest.mark.parametrize(
    ("text", "bind"),
    [
        ("10.0.0.1", ("10.0.0.1", None)),
        ("127.0.0.1:8443", ("127.0.0.1", 8443)),
        ("[::1]:8443", ("::1", 8443)),
        ("[::1]", ("::1", None)),
    ],
)
def test_the_page_is_bound_to_an_address_and_a_port(text: str, bind: tuple[str, int]) -> None:
    assert options("--bind", text).bind == bind


@pytest.mark.parametrize(
    "words",
    [("--bind", ":80"), ("--bind", "a:b"), ("--bind", "::1:9000"), ("--cameras", "none,left")],
)
def test_unreadable_values_are_refused(words: tuple[str, ...]) -> None:
    with pytest.raises(SystemExit):
        options(*words)
