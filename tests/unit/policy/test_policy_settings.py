"""The model server's parameters and specification: what is refused, and what agrees with whom."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import surg_core
from surg_cli.host import paths
from surg_core.contract import TASK_STATE_KEY, image_key
from surg_policy_bridge.server import cell_spec, listen_address
from surg_policy_bridge.server.server_parameters import Settings
from surg_policy_client.wire import MAX_PARTS, Message, encode
from surg_ros.params import ParamError, read

GOOD: dict[str, Any] = {"cell": "cells/sim_ur5e"}


def test_without_words_it_listens_on_this_machine_and_moves_nothing_by_itself() -> None:
    settings = read(Settings, GOOD)
    assert settings.bind == "tcp://127.0.0.1:5555" and settings.arms == ("PSM1",)
    assert not (settings.autostart or settings.privileged or settings.lockstep)
    assert settings.clip == ("jaw",)


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("cell", "", "~cell"),
        ("mode", "freerunn", "lockstep, freerun"),
        ("arms", [1], "~arms"),
        ("clip", ["jaw", "rcm_error"], "each once"),
        ("camera_rate", 0, "1 to 240"),
        ("answer_timeout", True, "0.1 to 9"),
        ("privileged", "yes", "true or false"),
        ("bind", "tcp://0.0.0.0:5555", "./surg policy keys"),
        ("bind", "tcp://localhost", "such as"),
        ("keys", 5, "~keys"),
        pytest.param("task", "x" * 257, "at most 256", id="task"),
        pytest.param("instruction", "x" * 1025, "at most 1024", id="instruction"),
        ("cameras", list("abcdefg"), "at most 6"),
        ("autostart", True, "~need_teleop: false"),
        ("cameras", "left,right,left", "each once"),
        ("arms", ["PSM1", "PSM1"], "each once"),
    ],
)
def test_what_must_not_be_used_is_said(name: str, value: Any, said: str) -> None:
    with pytest.raises(ParamError, match=f"(?s).*{said}") as error:
        read(Settings, {**GOOD, name: value})
    assert f"~{name}" in str(error.value)


def test_what_is_served_fits_onto_the_wire() -> None:
    most = {"task": "x" * 256, "instruction": "x" * 1024, "cameras": list("abcdef")}
    settings = read(Settings, {**GOOD, **most})
    sizes = dict.fromkeys(settings.cameras, (3, 4))
    cell = surg_core.load_cell(paths.ROOT / "cells" / "sim_ur5e")
    spec = cell_spec.make(cell, settings.arms, settings.task, sizes, None)
    arrays = {key: np.zeros(f.shape or (), f.dtype) for key, f in spec.observation.items()}
    numbers = {"session": 1, "seq": 1, "stamp_ns": 0, "episode": 0, "step": 0}
    head = {**numbers, "instruction": settings.instruction}
    assert len(encode(Message("OBS", head, arrays))) == MAX_PARTS
    with pytest.raises(ParamError, match="at most 5"):
        read(Settings, {**GOOD, **most, "privileged": True})
    assert cell_spec.too_large(1080, 1920) == ""
    assert "at most 8388608" in cell_spec.too_large(2160, 3840)


def test_ground_truth_is_of_a_simulator_only() -> None:
    settings = read(Settings, {**GOOD, "privileged": True})
    settings.check_arms(["PSM1"], ["simulator"])
    with pytest.raises(ParamError, match="not simulated"):
        settings.check_arms(["PSM1"], ["ur_driver"])
    with pytest.raises(ParamError, match="the cell has ECM"):
        settings.check_arms(["ECM"], ["simulator"])


@pytest.mark.parametrize(
    ("address", "plain", "keyed"),
    [
        ("tcp://127.0.0.1:5555", True, True),
        ("tcp://127.3.2.1:1", True, True),
        ("tcp://localhost:5555", True, True),
        ("tcp://[::1]:5555", True, True),
        ("ipc:///tmp/policy", True, True),
        ("tcp://10.0.0.7:5555", False, True),
        ("tcp://*:5555", False, True),
        ("tcp://localhost.evil.example:5555", False, True),
        ("ipc://@abstract", False, False),
        ("inproc://here", False, False),
    ],
)
def test_f19_what_other_machines_reach_needs_keys(address: str, plain: bool, keyed: bool) -> None:
    for has_keys, good in ((False, plain), (True, keyed)):
        if good:
            assert listen_address.check(address, has_keys) == address
        else:
            with pytest.raises(listen_address.BindError):
                listen_address.check(address, has_keys)


def test_the_specification_is_that_of_the_environment_and_of_datasets() -> None:
    from surg_sim.envs.surg_env import SurgEnv

    env = SurgEnv("bgr")
    cell = surg_core.load_cell(paths.CELLS / "sim_two_arms")
    names = ["mark[3]", "tear", "nodes[2,3]"]
    numbers = cell_spec.task_numbers(names)
    assert numbers == [
        *("mark_0", "mark_1", "mark_2", "tear"),
        *(f"nodes_{i}_{j}" for i in range(2) for j in range(3)),
    ]
    made = cell_spec.make(cell, env.arms, "bgr", {"endoscope_left": (480, 640)}, numbers)
    assert made.action is not None
    assert list(made.action.names) == env.action_names
    np.testing.assert_array_equal(made.action.low, env.action_space.low)
    np.testing.assert_array_equal(made.action.high, env.action_space.high)
    state = made.observation["observation.state"].names
    assert state is not None and list(state) == env.state_names[: len(state)]
    assert list(made.observation) == [
        "observation.state",
        "observation.rcm_frame",
        image_key("endoscope_left"),
        TASK_STATE_KEY,
    ]
    truth = made.observation[TASK_STATE_KEY]
    assert truth.privileged and truth.shape == (10,)
    env.close()
