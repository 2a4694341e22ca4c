"""Action spaces and the columns of a policy's actions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Sequence

from surg_policy_client import spec_checks as checks
from surg_policy_client.spec_checks import SpecError

ACTION_SPACES = {
    "absolute": {"x": "m", "y": "m", "z": "m", "roll": "rad", "jaw": "rad"},
    "relative": {"dx": "m", "dy": "m", "dz": "m", "droll": "rad", "jaw": "rad"},
    "velocity": {"vx": "m/s", "vy": "m/s", "vz": "m/s", "vroll": "rad/s", "jaw": "rad"},
    "joint": {"yaw": "rad", "pitch": "rad", "insertion": "m", "roll": "rad", "jaw": "rad"},
}
"""Columns of an arm's action and their units, by action space (docs/reference/policies.md)."""
_PLACE = {"x": "m", "y": "m", "z": "m"}
_JOINTS = ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw")
WRISTED_ACTION_SPACES = {
    "absolute": {**_PLACE, "qx": "1", "qy": "1", "qz": "1", "qw": "1", "jaw": "rad"},
    "relative": {
        **dict.fromkeys(("dx", "dy", "dz"), "m"),
        **dict.fromkeys(("drx", "dry", "drz", "jaw"), "rad"),
    },
    "velocity": {
        **dict.fromkeys(("vx", "vy", "vz"), "m/s"),
        **dict.fromkeys(("wx", "wy", "wz"), "rad/s"),
        "jaw": "rad",
    },
    "joint": {
        **dict.fromkeys(_JOINTS, "rad"),
        "insertion": "m",
        "jaw": "rad",
    },
}
"""The same of an arm whose instrument has a wrist."""
CHANGES = frozenset(
    name
    for spaces in (ACTION_SPACES, WRISTED_ACTION_SPACES)
    for space in ("relative", "velocity")
    for name in spaces[space]
) - {"jaw"}
"""Columns that hold a change: 0 keeps the target."""


@dataclass(frozen=True)
class ActionSpec:
    """One row of a chunk: targets for one grid time.

    The names of the columns choose the action space (`ACTION_SPACES`): a server offers each, and
    serves the one whose names a policy wants; without names the absolute one.

    Attributes:
        names: Of the columns, such as ``PSM1/x``.
        units: Of the columns (SI).
        frame: ``rcm``: each arm's own trocar frame.
        low: Smallest values in the workspace; None: unknown.
        high: Largest values in the workspace.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    frame: str | None = None
    low: tuple[float, ...] | None = None
    high: tuple[float, ...] | None = None

    @classmethod
    def of_space(
        cls, space: str, arms: Sequence[str] = ("PSM1",), wristed: Sequence[str] = ()
    ) -> ActionSpec:
        """The actions of an action space, for arms in their order; ``wristed`` have a wrist.

        Raises:
            SpecError: There is no such space.
        """
        if space not in ACTION_SPACES:
            raise SpecError(f"action space {space!r}; allowed: {', '.join(ACTION_SPACES)}")
        columns = {
            f"{arm}/{name}": unit
            for arm in arms
            for name, unit in (WRISTED_ACTION_SPACES if arm in wristed else ACTION_SPACES)[
                space
            ].items()
        }
        return cls(tuple(columns), tuple(columns.values()))

    @classmethod
    def among(cls, names: Sequence[str]) -> tuple[str, ActionSpec] | None:
        """Action space and actions of which all columns are among these; None: there is none."""
        arms = tuple(dict.fromkeys(name.rpartition("/")[0] for name in names if "/" in name))
        for space, columns in WRISTED_ACTION_SPACES.items():
            own = set(columns) - set(ACTION_SPACES[space])
            wristed = [arm for arm in arms if {f"{arm}/{name}" for name in own} <= set(names)]
            action = cls.of_space(space, arms, wristed)
            if arms and set(action.names) <= set(names):
                return space, action
        return None

    @classmethod
    def from_map(cls, value: Any, where: str) -> ActionSpec:
        """From a map with exactly its keys; ``where`` it is, for errors.

        Raises:
            SpecError: Names the place and what is allowed.
        """
        top = checks.map_of(value, where, ("names", "units", "frame", "low", "high"))
        action = cls(
            names=checks.texts(top["names"], f"{where}.names"),
            units=checks.texts(top["units"], f"{where}.units"),
            frame=checks.maybe(checks.text)(top["frame"], f"{where}.frame"),
            low=checks.maybe(checks.numbers)(top["low"], f"{where}.low"),
            high=checks.maybe(checks.numbers)(top["high"], f"{where}.high"),
        )
        if not action.names or len(set(action.names)) != len(action.names):
            raise SpecError(f"{where}.names: at least one, and each once")
        for part in ("units", "low", "high"):
            values = getattr(action, part)
            if values is not None and len(values) != len(action.names):
                raise SpecError(f"{where}.{part}: {len(values)} for {len(action.names)} names")
        return action
