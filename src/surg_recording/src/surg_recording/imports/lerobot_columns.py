"""Which columns of a LeRobot data set are which arm's: by their names, or by a map."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from surg_core.contract import ACTION_KEY, ARM_ACTION, ARM_STATE, STATE_KEY
from surg_recording.imports.bag_map import ARM_FACTS
from surg_recording.imports.lerobot_set import LeRobotData, names_of
from surg_recording.recording_errors import EpisodeError

_MEASURED = ARM_STATE[: len(ARM_ACTION)]  # the measured ones come first


@dataclasses.dataclass(frozen=True)
class ArmColumns:
    """Where the numbers of an arm are."""

    name: str
    measured: tuple[str, tuple[int, ...]]
    """Feature, and the columns of tip x, y, z, roll and jaw; -1: there is none."""
    goal: tuple[str, tuple[int, ...]] | None
    joints: tuple[str, tuple[int, ...]] | None


def columns_of(data: LeRobotData, stated: Mapping[str, Any] | None) -> list[ArmColumns]:
    """The arms of a data set, from its names or from a map's ``arms``.

    Raises:
        EpisodeError: No arm is found, or the map names what the data set lacks.
    """
    if stated is not None:
        return [_mapped(data, str(name), entry) for name, entry in stated.items()]
    names = _names(data, STATE_KEY)
    arms = dict.fromkeys(n.partition("/")[0] for n in names if n.endswith("/tip_x"))
    if not arms:
        raise EpisodeError(
            f"{data.root}: {STATE_KEY} has no columns such as PSM1/tip_x, but"
            f" {', '.join(names) or 'no names'}; --map FILE says which column is what"
        )
    if bent := [arm for arm in arms if f"{arm}/wrist_pitch" in names]:
        raise EpisodeError(f"{data.root}: an import would lose the wrist's turn of {bent[0]}")
    found = []
    for arm in arms:
        measured = tuple(names.index(f"{arm}/{name}") for name in _MEASURED)
        commanded = _names(data, ACTION_KEY)
        goal = [f"{arm}/{name}" for name in ARM_ACTION]
        joints = _names(data, "observation.joint_positions")
        mine = tuple(i for i, name in enumerate(joints) if name.startswith(f"{arm}/"))
        at = tuple(map(commanded.index, goal)) if set(goal) <= set(commanded) else None
        found.append(
            ArmColumns(
                arm,
                (STATE_KEY, measured),
                (ACTION_KEY, at) if at else None,
                ("observation.joint_positions", mine) if mine else None,
            )
        )
    return found


def check_keys(where: str, stated: Any, allowed: Sequence[str]) -> None:
    """Refuse a part of a map that is no table, or has another key."""
    if not isinstance(stated, Mapping) or set(stated) - set(allowed):
        raise EpisodeError(f"--map{where}: keys are {', '.join(allowed)}")


def _mapped(data: LeRobotData, arm: str, entry: Any) -> ArmColumns:
    if not isinstance(entry, Mapping) or not isinstance(entry.get("measured"), Mapping):
        raise EpisodeError(f"--map, arms.{arm}: 'measured' with x, y and z is needed")
    check_keys(f", arms.{arm}", entry, ("measured", "goal", *ARM_FACTS))

    def place(key: str, wanted: Sequence[str]) -> tuple[str, tuple[int, ...]] | None:
        stated = entry.get(key)
        if stated is None:
            return None
        check_keys(f", arms.{arm}.{key}", stated, ("feature", *ARM_ACTION))
        feature = str(stated.get("feature", STATE_KEY if key == "measured" else ACTION_KEY))
        return feature, tuple(
            _index(data, feature, stated.get(name), f"arms.{arm}.{key}.{name}") for name in wanted
        )

    measured = place("measured", ARM_ACTION)
    assert measured is not None
    if min(measured[1][:3]) < 0:
        raise EpisodeError(f"--map, arms.{arm}.measured: x, y and z are needed")
    return ArmColumns(arm, measured, place("goal", ARM_ACTION), None)


def _index(data: LeRobotData, feature: str, stated: Any, where: str) -> int:
    """Column number of a name or number; -1 for none."""
    names = _names(data, feature)
    if stated is None:
        return -1
    if isinstance(stated, int) and 0 <= stated < _width(data, feature):
        return stated
    if names.count(stated) == 1:
        return names.index(stated)
    if stated in names:
        raise EpisodeError(
            f"--map, {where}: {names.count(stated)} columns of {feature} are named {stated!r};"
            " give the number of one"
        )
    raise EpisodeError(
        f"--map, {where}: {stated!r} is not in {feature}; there are {', '.join(names) or 'none'}"
    )


def _width(data: LeRobotData, feature: str) -> int:
    if feature not in data.features:
        known = ", ".join(data.features)
        raise EpisodeError(f"{data.root}: no feature {feature}; there are {known}")
    return int(data.features[feature]["shape"][0])


def _names(data: LeRobotData, feature: str) -> list[str]:
    return names_of(data.features.get(feature, {}))
