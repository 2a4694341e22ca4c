"""What a cell's policy observes and commands: the specification shared with datasets."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import surg_core
from surg_core.contract import (
    ARM_ACTION,
    ARM_ACTION_UNITS,
    ARM_FORCE,
    ARM_FORCE_UNITS,
    ARM_STATE,
    ARM_STATE_UNITS,
    FORCE_KEY,
    SECOND_NS,
    STATE_KEY,
    STEP_NS,
    TASK_STATE_KEY,
    image_key,
)
from surg_policy_client.observation import RCM as RCM_KEY
from surg_policy_client.spec import ActionSpec, Feature, Spec
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
    observation = {
        STATE_KEY: _of_arms(arms, ARM_STATE, ARM_STATE_UNITS),
        RCM_KEY: Feature(dtype="f8", shape=(len(arms), 4, 4), unit="1,m", frame="world"),
    }
    if force:
        observation[FORCE_KEY] = _of_arms(arms, ARM_FORCE, ARM_FORCE_UNITS)
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
    low, high = _range(cell, arms)
    return Spec(
        task=task or "none",
        period_s=STEP_NS / SECOND_NS,
        observation=observation,
        action=ActionSpec(
            names=tuple(f"{arm}/{name}" for arm in arms for name in ARM_ACTION),
            units=ARM_ACTION_UNITS * len(arms),
            frame="rcm",
            low=tuple(low),
            high=tuple(high),
        ),
    ).served()


def _of_arms(arms: Sequence[str], names: Sequence[str], units: tuple[str, ...]) -> Feature:
    """The same numbers of each arm, in its rcm frame."""
    return Feature(
        dtype="f4",
        shape=(len(arms) * len(names),),
        unit=",".join(units * len(arms)),
        frame="rcm",
        names=tuple(f"{arm}/{name}" for arm in arms for name in names),
    )


def _range(cell: surg_core.Cell, arms: Sequence[str]) -> tuple[list[float], list[float]]:
    """Least and largest values that can be in the workspace."""
    low: list[float] = []
    high: list[float] = []
    for name in arms:
        arm = cell.arms[name]
        far = float(arm.limits.depth_max)
        wide = far * math.sin(min(float(arm.limits.cone), math.pi / 2))
        low += [-wide, -wide, 0.0, -math.pi, float(arm.instrument.jaw_min)]
        high += [wide, wide, far, math.pi, float(arm.instrument.jaw_max)]
    return low, high
