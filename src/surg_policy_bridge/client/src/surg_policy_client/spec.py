"""Specification of observations and actions, which both sides agree on before anything moves.

The `Spec` of a server is complete. The `Spec` of a policy may leave out what the policy does not
need; None matches anything. `mismatches` compares the two.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any, Mapping, Sequence

import numpy as np

from surg_policy_client import spec_checks as checks
from surg_policy_client.spec_checks import SpecError

DTYPES = {"u1": np.uint8, "i8": np.int64, "f4": np.float32, "f8": np.float64, "b1": np.bool_}
"""Element types of the wire, little-endian."""
MAX_FEATURES = 64
ACTION_SPACES = {
    "absolute": {"x": "m", "y": "m", "z": "m", "roll": "rad", "jaw": "rad"},
    "relative": {"dx": "m", "dy": "m", "dz": "m", "droll": "rad", "jaw": "rad"},
    "velocity": {"vx": "m/s", "vy": "m/s", "vz": "m/s", "vroll": "rad/s", "jaw": "rad"},
    "joint": {"yaw": "rad", "pitch": "rad", "insertion": "m", "roll": "rad", "jaw": "rad"},
}
"""Columns of an arm's action and their units, by action space (docs/reference/policies.md)."""
_PLACE = {"x": "m", "y": "m", "z": "m"}
WRISTED_ACTION_SPACES = {
    "absolute": {**_PLACE, "qx": "1", "qy": "1", "qz": "1", "qw": "1", "jaw": "rad"},
    "relative": {
        "dx": "m",
        "dy": "m",
        "dz": "m",
        "drx": "rad",
        "dry": "rad",
        "drz": "rad",
        "jaw": "rad",
    },
    "velocity": {
        "vx": "m/s",
        "vy": "m/s",
        "vz": "m/s",
        "wx": "rad/s",
        "wy": "rad/s",
        "wz": "rad/s",
        "jaw": "rad",
    },
    "joint": {
        "yaw": "rad",
        "pitch": "rad",
        "insertion": "m",
        "roll": "rad",
        "wrist_pitch": "rad",
        "wrist_yaw": "rad",
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
HOW = {
    "observation.images.": "pictures are served with ./surg run TASK --cameras, or ~cameras",
    "observation.force": "forces are served with ./surg run TASK --observe forces, or ~forces",
    "privileged.": "simulator truth is served with ./surg run --observe privileged, or ~privileged",
}
"""How to get observations that a server leaves out by default."""


@dataclass(frozen=True)
class Feature:
    """One observation. None: the server has none, or any matches.

    Attributes:
        dtype: One of `DTYPES`.
        shape: Sides; pictures are height, width, 3 (RGB).
        unit: SI, such as ``m``; comma-separated if the numbers differ.
        frame: Frame of the numbers, such as ``rcm``.
        names: Of the numbers of a vector, in order.
        privileged: Ground truth of the simulator, which no robot can measure.
    """

    dtype: str | None = None
    shape: tuple[int, ...] | None = None
    unit: str | None = None
    frame: str | None = None
    names: tuple[str, ...] | None = None
    privileged: bool = False


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


@dataclass(frozen=True)
class Spec:
    """Task, grid, observations and actions.

    Attributes:
        task: Name of the task; None: any.
        period_s: Grid period: row i of a chunk is due i periods after row 0 [s]; None: any.
        observation: Features by key; the keys are the dataset's (docs/reference/datasets.md).
        action: None: any (policy only).
    """

    task: str | None = None
    period_s: float | None = None
    observation: Mapping[str, Feature] = field(default_factory=dict)
    action: ActionSpec | None = None

    @classmethod
    def of_keys(cls, keys: Sequence[str]) -> Spec:
        """A policy's spec for these observations, of any shape and type."""
        return cls(observation={key: Feature() for key in keys})

    def to_map(self) -> dict[str, Any]:
        """As dicts and lists, for the wire."""
        return _lists(asdict(self))  # type: ignore[no-any-return]

    @classmethod
    def from_map(cls, value: Any) -> Spec:
        """From the result of `to_map`, with exactly its keys.

        Raises:
            SpecError: Names the place and what is allowed.
        """
        top = checks.map_of(value, "spec", ("task", "period_s", "observation", "action"))
        observation = top["observation"]
        if not isinstance(observation, dict) or len(observation) > MAX_FEATURES:
            raise SpecError(f"spec.observation: a map of at most {MAX_FEATURES} features")
        period = checks.maybe(checks.number)(top["period_s"], "spec.period_s")
        if period is not None and not 0.0 < period <= 10.0:
            raise SpecError(f"spec.period_s: more than 0 and at most 10 s, not {period!r}")
        return cls(
            task=checks.maybe(checks.text)(top["task"], "spec.task"),
            period_s=period,
            observation={
                checks.text(key, "spec.observation"): _feature(feature, f"spec.observation.{key}")
                for key, feature in observation.items()
            },
            action=checks.maybe(_action)(top["action"], "spec.action"),
        )

    def served(self) -> Spec:
        """This specification, checked to be complete.

        Raises:
            SpecError: Names what is missing.
        """
        missing = [key for key in ("task", "period_s", "action") if getattr(self, key) is None]
        for key, feature in self.observation.items():
            missing += [
                f"observation.{key}.{part}"
                for part in ("dtype", "shape")
                if getattr(feature, part) is None
            ]
        if not self.observation:
            missing.append("observation")
        if missing:
            raise SpecError(f"the spec of a server lacks: {', '.join(missing)}")
        return self

    def only(self, keys: Sequence[str]) -> Spec:
        """The same with these observations only, in their own order."""
        kept = {key: feature for key, feature in self.observation.items() if key in set(keys)}
        return Spec(self.task, self.period_s, kept, self.action)

    def mismatches(self, served: Spec) -> list[str]:
        """Differences between this (a policy's) and a server's spec, one sentence each.

        Limits (``low``, ``high``) are not compared.
        """
        differences = [
            f"{name}: the policy wants {checks.shown(mine)}, the server has {checks.shown(theirs)}"
            for name, mine, theirs in self._pairs(served)
            if mine is not None and mine != theirs
        ]
        for key in self.observation:
            if key not in served.observation:
                there = ", ".join(served.observation) or "none"
                how = next((f" ({HOW[kind]})" for kind in HOW if key.startswith(kind)), "")
                differences.append(
                    f"observation {key}: the policy wants it, the server has {there}{how}"
                )
        return differences

    def _pairs(self, served: Spec) -> list[tuple[str, Any, Any]]:
        pairs: list[tuple[str, Any, Any]] = [("task", self.task, served.task)]
        pairs.append(("period_s", self.period_s, served.period_s))
        for key, mine in self.observation.items():
            theirs = served.observation.get(key)
            if theirs is not None:
                pairs += [
                    (f"observation {key}, {part}", getattr(mine, part), getattr(theirs, part))
                    for part in ("dtype", "shape", "unit", "frame", "names")
                ]
        if self.action is not None:
            pairs += [
                (f"action, {part}", getattr(self.action, part), getattr(served.action, part, None))
                for part in ("names", "units", "frame")
            ]
        return pairs

    def check_observation(self, arrays: Mapping[str, np.ndarray]) -> list[str]:
        """What is wrong with observations of this spec, one sentence each."""
        problems = [f"{key} is missing" for key in self.observation if key not in arrays]
        for key, array in arrays.items():
            feature = self.observation.get(key)
            if feature is None:
                problems.append(f"{key} is not in the spec")
                continue
            dtype = array.dtype.str[1:]
            if feature.dtype is not None and dtype != feature.dtype:
                problems.append(f"{key} is {dtype}, the spec says {feature.dtype}")
            if feature.shape is not None and array.shape != feature.shape:
                problems.append(f"{key} has shape {array.shape}, the spec says {feature.shape}")
        return problems

    def check_chunk(self, chunk: np.ndarray) -> list[str]:
        """What is wrong with a chunk of actions [K, A], one sentence each."""
        if self.action is None:
            return ["the spec has no actions"]
        width = len(self.action.names)
        if chunk.ndim != 2 or chunk.shape[1] != width:
            names = ", ".join(self.action.names)
            return [f"a chunk is [K, {width}] ({names}), not {list(chunk.shape)}"]
        bad = np.argwhere(~np.isfinite(chunk))
        if len(bad):
            row, column = (int(i) for i in bad[0])
            name = self.action.names[column]
            return [f"row {row}, {name} is {chunk[row, column]}; allowed: finite numbers"]
        return []


def _feature(value: Any, where: str) -> Feature:
    top = checks.map_of(value, where, ("dtype", "shape", "unit", "frame", "names", "privileged"))
    if top["dtype"] is not None and (
        not isinstance(top["dtype"], str) or top["dtype"] not in DTYPES
    ):
        raise SpecError(
            f"{where}.dtype: one of {', '.join(DTYPES)}, not {checks.shown(top['dtype'])}"
        )
    if not isinstance(top["privileged"], bool):
        raise SpecError(f"{where}.privileged: true or false")
    return Feature(
        dtype=top["dtype"],
        shape=checks.maybe(checks.shape)(top["shape"], f"{where}.shape"),
        unit=checks.maybe(checks.text)(top["unit"], f"{where}.unit"),
        frame=checks.maybe(checks.text)(top["frame"], f"{where}.frame"),
        names=checks.maybe(checks.texts)(top["names"], f"{where}.names"),
        privileged=top["privileged"],
    )


def _action(value: Any, where: str) -> ActionSpec:
    top = checks.map_of(value, where, ("names", "units", "frame", "low", "high"))
    action = ActionSpec(
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


def _lists(value: Any) -> Any:
    """With lists in the place of tuples."""
    if isinstance(value, dict):
        return {key: _lists(item) for key, item in value.items()}
    return list(value) if isinstance(value, tuple) else value
