"""The safety controller judges every step of a policy at the moment of its execution.

It fails closed: a step that breaks a rule does not reach the arm. The limits are those of the cell,
and the tests of steps and workspace are `surg_core`'s (`check_step`, `inside_workspace`). Rules for
consecutive steps of a policy are added here. The controller's own gate follows and does not rely on
this one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

import surg_core
from surg_core.arm_view import ArmView
from surg_core.contract import SECOND_NS, STEP_NS
from surg_policy_bridge.server.policy_arm import Target

RULES = ("not_finite", "rcm_error", "workspace", "start", "step", "acceleration", "jaw")
"""In the order of evaluation."""
CLIPPABLE = ("workspace", "start", "step", "jaw")
"""Rules that can clip a step instead of rejecting it."""
CLIPPED = ("jaw",)
"""Rules that clip by default."""
HALVINGS = 40
"""Bisections of the search for the longest step that a rule allows."""


@dataclass(frozen=True)
class ArmLimits:
    """Limits of one arm of the cell.

    Attributes:
        limits: Of the arm, tightened by the cell.
        jaw_min: Jaw closed [rad].
        jaw_max: Jaw open [rad].
        servo_timeout: Timeout of a stream [ns].
    """

    limits: surg_core.Limits
    jaw_min: float
    jaw_max: float
    servo_timeout: int

    @classmethod
    def of(cls, arm: surg_core.Arm) -> ArmLimits:
        """Limits of an arm of a cell."""
        return cls(
            limits=arm.limits,
            jaw_min=float(arm.instrument.jaw_min),
            jaw_max=float(arm.instrument.jaw_max),
            servo_timeout=round(arm.robot.tuning.servo_timeout * SECOND_NS),
        )


@dataclass(frozen=True)
class Violation:
    """A rule that a step breaks.

    Attributes:
        rule: Of `RULES`.
        text: What was requested and what is allowed.
    """

    rule: str
    text: str


@dataclass(frozen=True)
class Verdict:
    """Verdict on one step of one arm.

    Attributes:
        target: What may be sent; None: the step is rejected.
        violations: The rules that clipped it, or the one that rejected it.
        velocity: Mean velocity of the tip during the step, (3,) [m/s].
    """

    target: Target | None
    violations: tuple[Violation, ...]
    velocity: np.ndarray


@dataclass(frozen=True)
class _SentStep:
    """A step that was sent."""

    at: int
    target: Target
    velocity: np.ndarray


class ArmSafety:
    """Judges the steps of one arm.

    Args:
        name: Name of the arm, for messages.
        limits: Of the arm.
        clip: Rules that clip; the others reject.

    Raises:
        ValueError: ``clip`` names a rule that cannot clip.
    """

    def __init__(self, name: str, limits: ArmLimits, clip: Iterable[str] = CLIPPED) -> None:
        self._name, self._own = name, limits
        self._clip = frozenset(clip)
        if unknown := self._clip - set(CLIPPABLE):
            raise ValueError(
                f"{', '.join(sorted(unknown))} cannot clip; allowed: {', '.join(CLIPPABLE)}"
            )
        self._last: _SentStep | None = None

    def forget(self) -> None:
        """The stream has ended; the next step starts a new one."""
        self._last = None

    def judge(self, target: Target, view: ArmView, at: int) -> Verdict:
        """Judge one step; `take` records it.

        Args:
            target: What the policy wants.
            view: The arm's newest cycle.
            at: Time of sending [ns]; not before the last step.
        """
        if self._last is not None and at - self._last.at > self._own.servo_timeout:
            self._last = None  # the arm has come to rest
        last = self._last
        before = last.target if last else Target(view.p_set, view.roll_set, view.jaw_set)
        since = (at - last.at if last else STEP_NS) / SECOND_NS
        violations: list[Violation] = []
        for rule in RULES:
            violation = self._check(rule, target, before, since, view)
            if violation is None:
                continue
            clipped = self._clipped(rule, target, before, since, view)
            if clipped is None:
                return Verdict(None, (violation,), np.zeros(3))
            violations.append(violation)
            target = clipped
        return Verdict(target, tuple(violations), (target.p - before.p) / since)

    def take(self, verdict: Verdict, at: int) -> None:
        """The judged step is sent."""
        assert verdict.target is not None
        self._last = _SentStep(at, verdict.target, verdict.velocity)

    # --- rules ------------------------------------------------------------------------------------

    def _check(
        self, rule: str, target: Target, before: Target, since: float, view: ArmView
    ) -> Violation | None:
        text: str = getattr(self, f"_{rule}")(target, before, since, view)
        return Violation(rule, f"{self._name}: {text}") if text else None

    def _not_finite(self, target: Target, before: Target, since: float, view: ArmView) -> str:
        del before, since, view
        return "" if np.isfinite(target.row).all() else f"{target.row.tolist()} is not finite"

    def _rcm_error(self, target: Target, before: Target, since: float, view: ArmView) -> str:
        del target, before, since
        limit = self._own.limits.rcm_error_warn
        if view.rcm_error <= limit:
            return ""
        error_mm, limit_mm = 1e3 * view.rcm_error, 1e3 * limit
        return f"the shaft is {error_mm:.2f} mm from its pivot; allowed: below {limit_mm:g} mm"

    def _workspace(self, target: Target, before: Target, since: float, view: ArmView) -> str:
        del before, since, view
        if surg_core.inside_workspace(self._own.limits, target.p):
            return ""
        beyond = surg_core.outside_workspace(self._own.limits, target.p)
        where = ", ".join(f"{1e3 * float(v):.4g}" for v in target.p)
        return (
            f"({where}) mm is {1e3 * beyond:.4g} mm outside the workspace; actions are in metres "
            "in the rcm frame"
        )

    def _start(self, target: Target, before: Target, since: float, view: ArmView) -> str:
        if self._last is not None or self._near(target, before, since, begins=True):
            return ""
        limits = self._own.limits
        return (
            f"the first step is {_distance(target, before)} from the set-point; allowed: "
            f"{1e3 * limits.step_slack:g} mm and {math.degrees(limits.step_roll_slack):.2g} deg"
        )

    def _step(self, target: Target, before: Target, since: float, view: ArmView) -> str:
        if self._last is None or self._near(target, before, since, begins=False):
            return ""
        limits = self._own.limits
        dt = min(since, limits.step_dt_max)
        far = limits.tip_velocity * dt + limits.step_slack
        turn = limits.roll_velocity * dt + limits.step_roll_slack
        return (
            f"{_distance(target, before)} in {1e3 * since:g} ms; allowed: {1e3 * far:.4g} mm "
            f"and {math.degrees(turn):.3g} deg"
        )

    def _near(self, target: Target, before: Target, since: float, begins: bool) -> bool:
        """The gate's test of a step."""
        distance = float(np.linalg.norm(target.p - before.p))
        turn = math.remainder(target.roll - before.roll, math.tau)
        reason = surg_core.check_step(self._own.limits, begins, since, distance, turn)
        return bool(reason == surg_core.Reason.NONE)

    def _acceleration(self, target: Target, before: Target, since: float, view: ArmView) -> str:
        if self._last is None:
            return ""
        # The tip's limit over this time, plus the slack of a step.
        limits = self._own.limits
        change = (target.p - before.p) / since - self._last.velocity
        allowed = limits.tip_acceleration * since + limits.step_slack / since
        if float(np.abs(change).max()) <= allowed:
            return ""
        return (
            f"the tip's velocity changes by {1e3 * float(np.abs(change).max()):.4g} mm/s "
            f"in {1e3 * since:g} ms; allowed: {1e3 * allowed:.4g} mm/s"
        )

    def _jaw(self, target: Target, before: Target, since: float, view: ArmView) -> str:
        del before, since, view
        low, high = self._own.jaw_min, self._own.jaw_max
        if low <= target.jaw <= high:
            return ""
        return f"jaw {target.jaw:.4g} rad; allowed: {low:g} to {high:g} rad"

    # --- clipping ---------------------------------------------------------------------------------

    def _clipped(
        self, rule: str, target: Target, before: Target, since: float, view: ArmView
    ) -> Target | None:
        """The step as far as the rule allows; None: rejected."""
        if rule not in self._clip:
            return None
        if rule == "jaw":
            return self._clipped_jaw(target)
        low, high = 0.0, 1.0
        if self._check(rule, before, before, since, view) is not None:
            return None  # even standing still breaks the rule
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            good = self._check(rule, before.toward(target, middle), before, since, view) is None
            low, high = (middle, high) if good else (low, middle)
        return before.toward(target, low)

    def _clipped_jaw(self, target: Target) -> Target | None:
        """Clip to the range, unless the value is off by more than the width of the range."""
        low, high = self._own.jaw_min, self._own.jaw_max
        if not low - (high - low) <= target.jaw <= high + (high - low):
            return None
        return Target(target.p, target.roll, min(max(target.jaw, low), high))


def _distance(target: Target, before: Target) -> str:
    distance = 1e3 * float(np.linalg.norm(target.p - before.p))
    turn = math.degrees(math.remainder(target.roll - before.roll, math.tau))
    return f"{distance:.4g} mm and {turn:.3g} deg"


class SafetyController:
    """Judges a step of all arms of a policy: all pass, or nothing is sent.

    Args:
        arms: Limits of each arm, in the order of the action.
        clip: Rules that clip; the others reject.
    """

    def __init__(self, arms: Mapping[str, ArmLimits], clip: Iterable[str] = CLIPPED) -> None:
        clip = tuple(clip)
        self._arms = {name: ArmSafety(name, limits, clip) for name, limits in arms.items()}

    def forget(self) -> None:
        """The stream has ended; the next step starts a new one."""
        for arm in self._arms.values():
            arm.forget()

    def judge(
        self, targets: Mapping[str, Target], views: Mapping[str, ArmView], at: int
    ) -> tuple[dict[str, Target], tuple[Violation, ...]]:
        """Judge one step of all arms.

        Args:
            targets: What the policy wants, by arm.
            views: The newest cycle of each.
            at: Time of sending [ns].

        Returns:
            Targets to send, by arm (empty: rejected), and the rules that clipped or rejected it.
        """
        verdicts = {n: arm.judge(targets[n], views[n], at) for n, arm in self._arms.items()}
        rejected = [v for v in verdicts.values() if v.target is None]
        if rejected:
            return {}, tuple(violation for v in rejected for violation in v.violations)
        passed: dict[str, Target] = {}
        for name, verdict in verdicts.items():
            self._arms[name].take(verdict, at)
            if verdict.target is not None:
                passed[name] = verdict.target
        return passed, tuple(violation for v in verdicts.values() for violation in v.violations)
