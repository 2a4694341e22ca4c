"""The set-up of a teleoperation read from parameters."""

from pathlib import Path

import pytest

from surg_cli.host import paths
from surg_ros.params import ParamError
from surg_teleop.follow.teleop_setup import read_setup

TWO_ARMS = paths.ROOT / "cells/sim_two_arms"


BUNDLED = paths.ROOT / "src/surg_teleop/motions/bundled.csv"


def test_a_system_is_read_from_parameters() -> None:
    params = {
        "cell": TWO_ARMS,
        "leader": "crtk",
        "settings": {"name": "MTMR"},
        "scale": 0.4,
        "second_leader": "motion",
        "second_settings": {"file": str(BUNDLED), "name": "helper"},
        "second_arm": "assistant",
        "assistant_frame": [0.0, 0.0, 0.0, 1.0],
    }
    found = read_setup(params, "/teleop")
    first, second = found.hands
    assert set(first.switch.arms) == {"PSM1", "ECM"}
    assert first.switch.endoscope.lock_rotation
    assert first.switch.instrument.scale == 0.4
    assert first.switch.instrument.settings.quiet > 0.1
    assert set(second.switch.arms) == {"assistant"}
    assert found.heard == ["PSM1", "ECM"]


@pytest.mark.parametrize(
    ("params", "name", "allowed"),
    [
        ({}, "leader", "text"),
        ({"leader": "crtk", "arm": "ECM"}, "arm", "PSM1, assistant"),
        ({"leader": "crtk", "scale": 5.0}, "scale", "0.01 to 1"),
        ({"leader": "crtk", "scale": "nan"}, "scale", "0.01 to 1"),
        ({"leader": "crtk", "speed": 1}, "speed", "~second_leader"),
        ({"leader": "crtk", "mapping": "both"}, "mapping", "position, rate"),
        ({"leader": "crtk", "settings": 3}, "settings", "dictionary"),
        ({"leader": "crtk", "arm": "assistant"}, "assistant_frame", "4 numbers"),
        ({"leader": "crtk", "cell": paths.ROOT / "cells/sim_ur5e"}, "view", "x, y, z, w"),
        (
            {"leader": "crtk", "second_leader": "crtk", "second_arm": "PSM1"},
            "second_arm",
            "does not drive",
        ),
    ],
)
def test_a_parameter_that_must_not_be_used_is_named(params: dict, name: str, allowed: str) -> None:
    with pytest.raises(ParamError) as caught:
        read_setup({"cell": TWO_ARMS, **params}, "/teleop")
    assert caught.value.name == name
    assert allowed in caught.value.allowed


def test_a_mapping_that_only_the_leader_names_is_checked_too(tmp_path: Path) -> None:
    leader = tmp_path / "own.py"
    leader.write_text(
        "class Own:\n"
        "    name, mapping = 'own', 'sideways'\n"
        "    def open(self): pass\n"
        "    def read(self, now): return None\n"
        "    def close(self): pass\n"
    )
    with pytest.raises(ParamError) as caught:
        read_setup({"cell": TWO_ARMS, "leader": str(leader)}, "/teleop")
    assert (caught.value.name, caught.value.value) == ("mapping", "sideways")
