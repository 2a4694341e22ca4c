"""Limits by which a run is judged."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

SETTING_BOUNDS: Mapping[str, Mapping[str, float]] = {"phantom": {"mean": 0.05, "max": 0.3}}
"""Largest kinematic RCM deviation in an episode of a task, by physical setting [mm]."""
ANY_SETTING: Mapping[str, float] = {"max": 1.0}
"""Bounds of a setting without its own [mm]."""


@dataclasses.dataclass(frozen=True)
class Limit:
    """One stated limit and the measured value."""

    name: str
    text: str
    measured: float | None
    bound: float
    at_least: bool = False
    judged: bool = True
    """False: for information only."""

    @property
    def met(self) -> bool:
        """Whether the limit is met; NaN and None never meet it."""
        if self.measured is None or not math.isfinite(self.measured):
            return False
        return self.measured >= self.bound if self.at_least else self.measured <= self.bound

    def to_json(self) -> dict[str, Any]:
        """The entry in summary.json."""
        entry = dataclasses.asdict(self)
        sense = "at least" if entry.pop("at_least") else "at most"
        return {**entry, "sense": sense, "met": self.met}

    def __str__(self) -> str:
        """The measured value and the limit."""
        sign = "≥" if self.at_least else "≤"
        known = self.measured is not None and math.isfinite(self.measured)
        measured = f"{self.measured:.4g}" if known else "not measured"
        return f"{self.text}: {measured}, allowed {sign} {self.bound:g}"


def stated_limits(result: Mapping[str, Any], info: Mapping[str, Any]) -> list[Limit]:
    """The limits by which a run is judged, with the measured values of ``summary.json``.

    An episode of a task has limits on the RCM deviation only. The task judges its own success, and
    its tip path is a means to that end. ``info`` is the manifest's entry ``run``.
    """
    if info.get("setting"):
        return [
            Limit(
                f"rcm_kinematic_{name}",
                f"kinematic RCM deviation, {name} [mm]",
                result["rcm_kinematic_mm"][name],
                bound,
            )
            for name, bound in SETTING_BOUNDS.get(info["setting"], ANY_SETTING).items()
        ]
    kinematic, true = result["rcm_kinematic_mm"], result["rcm_true_mm"]
    tip, path = result["tip_error_mm"], result["path_length_mm"]
    ratio = abs(path["executed"] / path["input"] - 1.0) * 100.0 if path["input"] else math.nan
    limits = [
        Limit("rcm_kinematic_mean", "kinematic RCM deviation, mean [mm]", kinematic["mean"], 0.03),
        Limit("rcm_kinematic_max", "kinematic RCM deviation, max [mm]", kinematic["max"], 0.3),
    ]
    if true is not None:
        limits.append(Limit("rcm_true_max", "true RCM deviation, max [mm]", true["max"], 0.5))
    limits += [
        Limit("tip_error_rms", "tip error, rms, lag removed [mm]", tip["rms"], 1.0),
        Limit("path_length", "executed path against input's, difference [%]", ratio, 3.0),
        Limit("enabled", "cycles enabled [%]", 100.0 * result["enabled_fraction"], 100.0, True),
        Limit("unscaled", "cycles unscaled [%]", 100.0 * result["unscaled_fraction"], 98.0, True),
    ]
    sweep, judged = result["shaft_sweep_deg"], bool(info.get("full_motion", False))
    return [*limits, Limit("shaft_sweep", "shaft sweep [deg]", sweep, 20.0, True, judged)]
