"""What a cell's policy observes and commands: the specification shared with datasets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import surg_core
from surg_core.action_space import ActionSpace, absolute_range, wrist_of_arm
from surg_core.contract import (
    ARM_FORCE,
    ARM_FORCE_UNITS,
    FORCE_KEY,
    SECOND_NS,
    STATE_KEY,
    STEP_NS,
    TASK_STATE_KEY,
    arm_state,
    image_key,
)
from surg_policy_client.action_spec import ActionSpec
from surg_policy_client.observation import RCM as RCM_KEY
from surg_policy_client.spec import Feature, Spec
from surg_policy_client.wire import MAX_PART
from surg_recording.episode import table_columns


def task_numbers(names: Sequence[str]) -> list[str]:
    """Names of the numbers of a surg_msgs/TaskState, as in a dataset."""
    columns = table_columns.task(names)[len(table_columns.TASK) :]
    return [name.removeprefix(table_columns.TASK_PREFIX) for name in columns]


def too_large(height: int, width: int) -> str:
    """Why a picture of so many pixels cannot be served; empty: it can."""
    size = 3 * height * width
    if size <= MAX_PART:
        return ""
    return f"a picture of {width} x {height} pixels has {size} bytes: at most {MAX_PART} are served"


def make(
    cell: surg_core.Cell,
    arms: Sequence[str],
    task: str,
    cameras: Mapping[str, tuple[int, int]],
    numbers: Sequence[str] | None,
    force: bool = False,
) -> Spec:
    """The specification for the arms that the policy commands.

    ``cameras`` holds height and width [px] by name, ``numbers`` the names of the task's ground
    truth, None: it is not served. ``force``: whether forces at tip and trocar are served.
    """
    wrists = {arm: wrist_of_arm(cell.arms[arm]) for arm in arms}
    space = ActionSpace(wrists=tuple(wrists.values()))
    observation = {
        STATE_KEY: _of_arms({arm: arm_state(wrist is not None) for arm, wrist in wrists.items()}),
        RCM_KEY: Feature(dtype="f8", shape=(len(arms), 4, 4), unit="1,m", frame="world"),
    }
    if force:
        observation[FORCE_KEY] = _of_arms(dict.fromkeys(arms, (ARM_FORCE, ARM_FORCE_UNITS)))
    for camera, (height, width) in cameras.items():
        observation[image_key(camera)] = Feature(dtype="u1", shape=(height, width, 3))
    if numbers is not None:
        observation[TASK_STATE_KEY] = Feature(
            dtype="f4",
            shape=(len(numbers),),
            unit="SI",
            frame="world",
            names=tuple(numbers),
            privileged=True,
        )
    ranges = [absolute_range(cell.arms[arm]) for arm in arms]
    return Spec(
        task=task or "none",
        period_s=STEP_NS / SECOND_NS,
        observation=observation,
        action=ActionSpec(
            names=space.columns(arms),
            units=space.units(arms),
            frame="rcm",
            low=tuple(number for low, _ in ranges for number in low),
            high=tuple(number for _, high in ranges for number in high),
        ),
    ).served()


def _of_arms(numbers: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]]) -> Feature:
    """Names and units of each arm's numbers, in its rcm frame."""
    names = tuple(f"{arm}/{name}" for arm, (own, _) in numbers.items() for name in own)
    return Feature(
        dtype="f4",
        shape=(len(names),),
        unit=",".join(unit for _, units in numbers.values() for unit in units),
        frame="rcm",
        names=names,
    )
