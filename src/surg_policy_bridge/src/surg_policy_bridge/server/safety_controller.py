"""The safety controller judges every step of a policy at the moment of its execution.

It fails closed: a step that breaks a rule does not reach the arm. The limits are those of the cell,
and the tests of steps and workspace are `surg_core`'s (`check_step`, `inside_workspace`). Rules for
consecutive steps of a policy are added here. The controller's own gate follows and does not rely on
this one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

import surg_core
from surg_core.arm_view import ArmView
from surg_core.contract import SECOND_NS, STEP_NS
from surg_policy_bridge.server.policy_arm import Target

RULES = ("not_finite", "rcm_error", "workspace", "start", "step", "acceleration", "jaw")
"""In the order of evaluation."""
CLIPPABLE = ("workspace", "start", "step", "acceleration", "jaw")
"""Rules that can clip a step instead of rejecting it."""
CLIPPED = ("jaw",)
"""Rules that clip by default."""
PACED = ("start", "step", "acceleration", "jaw")
"""Rules that clip where the arm shall follow a policy that was late, at the allowed pace."""
HALVINGS = 40
"""Bisections of the search for the longest step that a rule allows."""


@dataclass(frozen=True)
class Violation:
    """A rule of `RULES` that a step breaks: what was requested and what is allowed."""

    rule: str
    text: str


@dataclass(frozen=True)
class Verdict:
    """Verdict on one step of one arm."""

    target: Target | None  # what may be sent; None: the step is rejected
    violations: tuple[Violation, ...]  # the rules that clipped it, or the one that rejected it
    velocity: np.ndarray  # mean velocity of the tip during the step, (3,) [m/s]


@dataclass(frozen=True)
class _SentStep:
    at: int
    target: Target
    velocity: np.ndarray


@dataclass(frozen=True)
class _Step:
    """A step to judge: from a target to the next one, in ``since`` [s]."""

    target: Target
    before: Target
    since: float
    view: ArmView


class ArmSafety:
    """Judges the steps of one arm of a cell, whose name is for messages.

    Raises:
        ValueError: ``clip`` names a rule that cannot clip.
    """

    def __init__(self, name: str, arm: surg_core.Arm, clip: Iterable[str] = CLIPPED) -> None:
        self._name, self._limits, self._instrument = name, arm.limits, arm.instrument
        self._servo_timeout = round(arm.robot.tuning.servo_timeout * SECOND_NS)
        self._clip = frozenset(clip)
        if unknown := self._clip - set(CLIPPABLE):
            raise ValueError(
                f"{', '.join(sorted(unknown))} cannot clip; allowed: {', '.join(CLIPPABLE)}"
            )
        self._last: _SentStep | None = None
        self._rules: dict[str, Callable[[_Step], str]] = {
            rule: getattr(self, f"_{rule}") for rule in RULES
        }

    def forget(self) -> None:
        """The stream has ended; the next step starts a new one."""
        self._last = None

    def streaming(self, at: int) -> bool:
        """Whether a step was sent so short a time before [ns] that the arm is not at rest yet."""
        return self._last is not None and at - self._last.at <= self._servo_timeout

    def judge(self, target: Target, view: ArmView, at: int) -> Verdict:
        """Judge one step from the arm's newest cycle, sent at [ns]; `take` records it."""
        if not self.streaming(at):
            self._last = None
        last = self._last
        if last is None:
            target = replace(target, p=view.first_step(target.p, self._limits.step_slack))
        before = last.target if last else Target.held(view)
        step = _Step(target, before, (at - last.at if last else STEP_NS) / SECOND_NS, view)
        violations: list[Violation] = []
        for rule, broken in self._rules.items():
            text = broken(step)
            if not text:
                continue
            violation = Violation(rule, f"{self._name}: {text}")
            clipped = self._clipped(rule, step)
            if clipped is None:
                return Verdict(None, (violation,), np.zeros(3))
            violations.append(violation)
            step = replace(step, target=clipped)
        velocity = (step.target.p - before.p) / step.since
        return Verdict(step.target, tuple(violations), velocity)

    def take(self, verdict: Verdict, at: int) -> None:
        """The judged step is sent."""
        assert verdict.target is not None
        self._last = _SentStep(at, verdict.target, verdict.velocity)

    # --- rules: why a step breaks one; empty: it does not -----------------------------------------

    def _not_finite(self, step: _Step) -> str:
        row = step.target.row
        return "" if np.isfinite(row).all() else f"{row.tolist()} is not finite"

    def _rcm_error(self, step: _Step) -> str:
        error, limit = step.view.rcm_error, self._limits.rcm_error_warn
        if error <= limit:
            return ""
        return (
            f"the shaft is {1e3 * error:.2f} mm from its pivot; allowed: below {1e3 * limit:g} mm"
        )

    def _workspace(self, step: _Step) -> str:
        limits, p = self._limits, step.target.p
        if surg_core.inside_workspace(limits, p):
            return self._bent(step.target)
        where = ", ".join(f"{1e3 * float(v):.4g}" for v in p)
        return (
            f"({where}) mm is {1e3 * surg_core.outside_workspace(limits, p):.4g} mm outside the "
            "workspace; actions are in metres in the rcm frame"
        )

    def _bent(self, target: Target) -> str:
        """Why the wrist cannot be so."""
        wrist = self._instrument.wrist
        if wrist is None:
            return ""
        least, most = wrist.min[:2], wrist.max[:2]
        if ((least <= target.turns) & (target.turns <= most)).all():
            return ""
        low, high, asked = (_degrees(turns) for turns in (least, most, target.turns))
        return f"the wrist's pitch and yaw of {asked} deg; allowed: {low} to {high} deg"

    def _start(self, step: _Step) -> str:
        if self._last is not None or self._near(step, begins=True):
            return ""
        limits = self._limits
        return (
            f"the first step is {_distance(step)} from the set-point; allowed: "
            f"{1e3 * limits.step_slack:g} mm and {math.degrees(limits.step_roll_slack):.2g} deg"
        )

    def _step(self, step: _Step) -> str:
        if self._last is None or self._near(step, begins=False):
            return ""
        limits = self._limits
        dt = min(step.since, limits.step_dt_max)
        far = limits.tip_velocity * dt + limits.step_slack
        turn = limits.roll_velocity * dt + limits.step_roll_slack
        return (
            f"{_distance(step)} in {1e3 * step.since:g} ms; allowed: {1e3 * far:.4g} mm "
            f"and {math.degrees(turn):.3g} deg"
        )

    def _near(self, step: _Step, begins: bool) -> bool:
        """The gate's test of a step."""
        limits, wrist, since = self._limits, self._instrument.wrist, step.since
        distance, turn = _change(step)
        reason = surg_core.check_step(limits, begins, since, distance, turn)
        if reason == surg_core.Reason.NONE and wrist is not None:
            turned = float(np.abs(step.target.turns - step.before.turns).max())
            reason = surg_core.check_wrist_step(limits, wrist, begins, since, turned)
        return bool(reason == surg_core.Reason.NONE)

    def _acceleration(self, step: _Step) -> str:
        if self._last is None:
            return ""
        change, allowed = self._change_of_velocity(step)
        largest = float(np.abs(change).max())
        if largest <= allowed:
            return ""
        return (
            f"the tip's velocity changes by {1e3 * largest:.4g} mm/s in {1e3 * step.since:g} ms; "
            f"allowed: {1e3 * allowed:.4g} mm/s"
        )

    def _change_of_velocity(self, step: _Step) -> tuple[np.ndarray, float]:
        """Of the tip since the last step, (3,), and what is allowed on each axis [m/s]."""
        assert self._last is not None
        limits, since = self._limits, step.since
        velocity = (step.target.p - step.before.p) / since
        # The tip's limit over this time, plus the slack of a step.
        allowed = limits.tip_acceleration * since + limits.step_slack / since
        return velocity - self._last.velocity, float(allowed)

    def _jaw(self, step: _Step) -> str:
        low, high, jaw = self._instrument.jaw_min, self._instrument.jaw_max, step.target.jaw
        return "" if low <= jaw <= high else f"jaw {jaw:.4g} rad; allowed: {low:g} to {high:g} rad"

    # --- clipping ---------------------------------------------------------------------------------

    def _clipped(self, rule: str, step: _Step) -> Target | None:
        """The step as far as the rule allows; None: rejected."""
        if rule not in self._clip:
            return None
        target, before, broken = step.target, step.before, self._rules[rule]
        if rule == "jaw":
            return self._clipped_jaw(target)
        if rule == "acceleration":
            return self._slower_to_change(step)
        if broken(replace(step, target=before)):
            return None  # even standing still breaks the rule
        low, high = 0.0, 1.0
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            good = not broken(replace(step, target=before.toward(target, middle)))
            low, high = (middle, high) if good else (low, middle)
        return before.toward(target, low)

    def _slower_to_change(self, step: _Step) -> Target | None:
        """The velocity goes toward the wanted one as far as it may.

        A velocity between two that a step may have is one as well. None: it leaves the workspace.
        """
        assert self._last is not None
        change, allowed = self._change_of_velocity(step)
        share = (1.0 - 1e-9) * allowed / float(np.abs(change).max())
        velocity = self._last.velocity + share * change
        target = replace(step.target, p=step.before.p + step.since * velocity)
        slower = replace(step, target=target)
        return None if self._workspace(slower) or self._step(slower) else target

    def _clipped_jaw(self, target: Target) -> Target | None:
        """Clip to the range, unless the value is off by more than the width of the range."""
        low, high = self._instrument.jaw_min, self._instrument.jaw_max
        if not low - (high - low) <= target.jaw <= high + (high - low):
            return None
        return replace(target, jaw=min(max(target.jaw, low), high))


def _change(step: _Step) -> tuple[float, float]:
    """Distance of the shaft's end [m], and turn of the roll [rad] on the shorter way."""
    distance = float(np.linalg.norm(step.target.p - step.before.p))
    return distance, math.remainder(step.target.roll - step.before.roll, math.tau)


def _distance(step: _Step) -> str:
    distance, turn = _change(step)
    turns = step.target.turns - step.before.turns
    wrist = f" (wrist: {_degrees(turns)} deg)" if len(turns) else ""
    return f"{1e3 * distance:.4g} mm and {math.degrees(turn):.3g} deg{wrist}"


def _degrees(turns: np.ndarray) -> str:
    return ", ".join(f"{angle:.3g}" for angle in np.degrees(turns))


class SafetyController:
    """Judges a step of all arms of a policy: all pass, or nothing is sent.

    ``arms`` are in the order of the action; rules of ``clip`` clip, the others reject.
    """

    def __init__(self, arms: Mapping[str, surg_core.Arm], clip: Iterable[str] = CLIPPED) -> None:
        clip = tuple(clip)
        self._arms = {name: ArmSafety(name, arm, clip) for name, arm in arms.items()}

    def forget(self) -> None:
        """The stream has ended; the next step starts a new one."""
        for arm in self._arms.values():
            arm.forget()

    def streaming(self, at: int) -> bool:
        """Whether the next step [ns] continues a stream; otherwise it starts one."""
        return any(arm.streaming(at) for arm in self._arms.values())

    def judge(
        self, targets: Mapping[str, Target], views: Mapping[str, ArmView], at: int
    ) -> tuple[dict[str, Target], tuple[Violation, ...]]:
        """Judge one step of all arms at the time of sending [ns].

        Returns the targets to send, by arm (empty: rejected), and the rules that clipped or
        rejected it.
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
