"""Specification of observations and actions, which both sides agree on before anything moves.

The `Spec` of a server is complete. The `Spec` of a policy may leave out what the policy does not
need; None matches anything. `mismatches` compares the two.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any, Mapping, Sequence

import numpy as np

from surg_policy_client import spec_checks as checks
from surg_policy_client.action_spec import ActionSpec
from surg_policy_client.spec_checks import SpecError

DTYPES = {"u1": np.uint8, "i8": np.int64, "f4": np.float32, "f8": np.float64, "b1": np.bool_}
"""Element types of the wire, little-endian."""
MAX_FEATURES = 64
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
            action=checks.maybe(ActionSpec.from_map)(top["action"], "spec.action"),
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


def _lists(value: Any) -> Any:
    """With lists in the place of tuples."""
    if isinstance(value, dict):
        return {key: _lists(item) for key, item in value.items()}
    return list(value) if isinstance(value, tuple) else value
