"""The contract: one definition, consistent with the core, the messages and the policy client."""

from __future__ import annotations

import re

import pytest

from surg_cli.host import paths
from surg_core import contract
from surg_policy_client import action_spec, observation, spec

MESSAGE = paths.ROOT / "src" / "surg_msgs" / "msg" / "Cycle.msg"
CODE = sorted(
    file
    for top in ("src", "tools")
    for file in (paths.ROOT / top).rglob("*.py")
    if file.name != "contract.py" and "build" not in file.parts
)


def cycle_numbers() -> dict[str, int]:
    """The constants of surg_msgs/Cycle."""
    found = re.findall(r"^uint8 (\w+)=(\d+)", MESSAGE.read_text(), re.MULTILINE)
    return {name: int(number) for name, number in found}


def test_numbers_are_those_of_the_cycle_message() -> None:
    numbers = cycle_numbers()
    for name in contract.STATE_NAMES:
        assert numbers[name] == getattr(contract, name) == contract.STATE_NAMES.index(name)
    streams = {number for name, number in numbers.items() if name.startswith("SERVO_")}
    velocities = {number for name, number in numbers.items() if re.fullmatch(r"SERVO_.V", name)}
    assert set(contract.STREAMS) == streams
    assert set(contract.POSITION_STREAMS) == streams - velocities


def test_times_agree_and_are_exact() -> None:
    assert round(contract.TICK * contract.SECOND_NS) == contract.TICK_NS
    assert contract.STEP_NS == contract.GRID * contract.TICK_NS
    assert contract.GRID_RATE * contract.STEP_NS == contract.SECOND_NS, "seconds are on the grid"
    assert contract.STEP == 0.05


def test_every_column_has_a_name_and_a_unit() -> None:
    for names, units in (
        (contract.ARM_STATE, contract.ARM_STATE_UNITS),
        (contract.WRISTED_STATE, contract.WRISTED_STATE_UNITS),
        (contract.ARM_ACTION, contract.ARM_ACTION_UNITS),
    ):
        assert len(names) == len(set(names)) == len(units)


def test_the_policy_client_has_the_same_keys() -> None:
    assert observation.STATE == contract.STATE_KEY
    for spaces, state in (
        (action_spec.ACTION_SPACES, contract.ARM_STATE),
        (action_spec.WRISTED_ACTION_SPACES, contract.WRISTED_STATE),
    ):
        held = {
            name: [form.format(name) for form in observation.HELD] for name in spaces["absolute"]
        }
        assert all(set(columns) & set(state) for columns in held.values())
    assert action_spec.ACTION_SPACES == contract.ACTION_SPACES
    assert action_spec.WRISTED_ACTION_SPACES == contract.WRISTED_ACTION_SPACES
    assert contract.IMAGE_PREFIX in spec.HOW
    assert contract.TASK_STATE_KEY.startswith(tuple(spec.HOW))


@pytest.mark.parametrize(
    ("camera", "key"),
    [
        ("endoscope_left", "observation.images.endoscope.left"),
        ("room_right", "observation.images.room.right"),
        ("left", "observation.images.left"),
        ("room", "observation.images.room"),
    ],
)
def test_image_keys(camera: str, key: str) -> None:
    assert contract.image_key(camera) == key


@pytest.mark.parametrize(
    "definition",
    [
        r"^(GRID|TICK|TICK_NS|SECOND|SECOND_NS|NS|PERIOD|PERIOD_NS) = (25|0\.002|\d+_000_000)$",
        r"\"tip_z\", \"roll\"",
        r"\"x\", \"y\", \"z\", \"roll\", \"jaw\"",
        r"\(1, 2, 3, 4, 9\)",
        r"= \"(observation\.state|privileged\.task_state)\"",
    ],
)
def test_nobody_else_defines_it(definition: str) -> None:
    pattern = re.compile(definition, re.MULTILINE)
    # What runs beside a policy, where nothing else of the platform is installed, keeps a copy.
    alone = (
        paths.ROOT / "src/surg_policy_bridge/client",
        paths.ROOT / "src/surg_learn/src/surg_learn/cloning/arm_columns.py",
    )
    own = [file for file in CODE if not any(file.is_relative_to(each) for each in alone)]
    assert len(own) > 100
    found = [str(file.relative_to(paths.ROOT)) for file in own if pattern.search(file.read_text())]
    assert found == []
