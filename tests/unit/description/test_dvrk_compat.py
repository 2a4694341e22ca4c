"""The tables of the compatibility node: nothing of a dVRK client is missing, nothing is obeyed."""

from __future__ import annotations

from surg_cli.graph.topic_contract import load
from surg_dvrk_compat.interface import COMMANDS, FEEDBACK, SYSTEM_COMMANDS, Throttle, answer

# What the public classes arm and psm publish and subscribe, below the arm's name.
PUBLISHED = {
    "state_command", "hold", "free", "servo_jp", "servo_jr", "servo_cp", "servo_jf", "move_jp",
    "move_jr", "move_cp", "spatial/servo_cf", "body/servo_cf", "body/set_cf_orientation_absolute",
    "use_gravity_compensation", "trajectory_j/set_ratio", "jaw/servo_jp", "jaw/move_jp",
    "jaw/servo_jf", "emulate_tool_present",
}  # fmt: skip
SUBSCRIBED = {
    "operating_state", "setpoint_js", "setpoint_cp", "measured_js", "measured_cp", "measured_cv",
    "spatial/measured_cf", "spatial/jacobian", "body/measured_cf", "body/jacobian",
    "local/measured_cp", "local/setpoint_cp", "trajectory_j/ratio", "jaw/measured_js",
    "jaw/setpoint_js",
}  # fmt: skip
# What the public classes console and system publish and subscribe.
CONSOLE = {
    "in": {"enable", "set_scale", "select", "unselect"},
    "out": {"scale", "selected", "unselected"},
}
SYSTEM = {"power_off", "power_on", "home", "set_volume", "beep", "string_to_speech"}
SERVICES = {"forward_kinematics", "inverse_kinematics", "local/forward_kinematics"}


def offered(direction: str, *nodes: str) -> set[str]:
    return {
        entry.name.removeprefix("<arm>/")
        for entry in load().entries
        if entry.direction == direction and entry.node in nodes
    }


def test_every_topic_of_a_dvrk_client_has_another_side() -> None:
    assert offered("in", "controller", "dvrk_compat") >= PUBLISHED
    assert offered("out", "controller", "dvrk_compat") >= SUBSCRIBED
    assert offered("service", "controller") >= SERVICES
    for direction, topics in CONSOLE.items():
        assert offered(direction, "teleop") >= {f"/console/teleop/{topic}" for topic in topics}
    assert offered("in", "dvrk_compat") >= {f"/system/{topic}" for topic in SYSTEM}


def test_the_node_offers_what_the_page_says_and_nothing_of_the_controllers() -> None:
    commands, feedback = {c.topic for c in COMMANDS}, {f.topic for f in FEEDBACK}
    system = {f"/system/{c.topic}" for c in SYSTEM_COMMANDS}
    assert commands | system == offered("in", "dvrk_compat")
    assert feedback | {"/system/warning"} == offered("out", "dvrk_compat")
    assert not commands & offered("in", "controller")
    assert not feedback & offered("out", "controller")


def test_an_answer_names_arm_topic_sender_and_cure() -> None:
    for command in COMMANDS:
        text = answer("PSM1", command, "/script")
        assert text.startswith(f"PSM1: {command.topic} from /script ignored: ")
        assert len(command.why) > 30


def test_a_stream_is_answered_once_a_second() -> None:
    throttle = Throttle()
    said = [t for t in range(2500) if throttle.passes("servo_jf /script", t / 1000)]
    assert said == [0, 1000, 2000]
    assert throttle.passes("servo_jf /other", 2.4)
