"""The safety controller: every step of a policy is judged here at the moment it would be executed.

It fails closed: what no rule lets through does not reach the arm. Limits are the cell's and the
tests of steps and workspace are `surg_core`'s own (`check_step`, `inside_workspace`); no limit
stands here a second time. What is particular to policies is added: consecutive steps, the change of
speed between them, the age of what the policy saw (`server`). The controller's own gate comes
after this one and believes none of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

import surg_core
from surg_policy_bridge.server.policy_arm import PERIOD, SECOND, ArmView, Target

RULES = ("not_finite", "rcm_error", "workspace", "start", "step", "acceleration", "jaw")
"""In the order in which they are asked."""
CLIPPABLE = ("workspace", "start", "step", "jaw")
"""Rules that can shorten a step instead of rejecting it."""
CLIPPED = ("jaw",)
"""Rules that do so unless the settings say otherwise."""
HALVINGS = 40
"""Of the search for the longest step that a rule lets through."""


@dataclass(frozen=True)
class ArmLimits:
    """What the cell says of one arm.

    Attributes:
        limits: Its limits, tightened by the cell.
        jaw_min: Jaw closed [rad].
        jaw_max: Jaw open [rad].
        servo_timeout: A stream that is silent for longer has ended [ns].
    """

    limits: surg_core.Limits
    jaw_min: float
    jaw_max: float
    servo_timeout: int

    @classmethod
    def of(cls, arm: surg_core.Arm) -> ArmLimits:
        """Those of an arm of a cell."""
        return cls(
            limits=arm.limits,
            jaw_min=float(arm.instrument.jaw_min),
            jaw_max=float(arm.instrument.jaw_max),
            servo_timeout=round(arm.robot.tuning.servo_timeout * SECOND),
        )


@dataclass(frozen=True)
class Broken:
    """A rule that a step breaks.

    Attributes:
        rule: Of `RULES`.
        text: What was asked for, what is allowed.
    """

    rule: str
    text: str


@dataclass(frozen=True)
class Verdict:
    """What becomes of one step of one arm.

    Attributes:
        target: What may be sent; None: nothing.
        broken: The rules that clipped it or, without a target, the one that rejected it.
        velocity: Mean velocity of the tip on the way there, (3,) [m/s].
    """

    target: Target | None
    broken: tuple[Broken, ...]
    velocity: np.ndarray


@dataclass(frozen=True)
class _Taken:
    """A step that was sent."""

    at: int
    target: Target
    velocity: np.ndarray


class ArmSafety:
    """Judges the steps of one arm.

    Args:
        name: The arm's, for the texts.
        limits: What the cell says of it.
        clip: Rules that clip; the others reject.

    Raises:
        ValueError: A rule that cannot clip.
    """

    def __init__(self, name: str, limits: ArmLimits, clip: Iterable[str] = CLIPPED) -> None:
        self._name, self._own = name, limits
        self._clip = frozenset(clip)
        if strange := self._clip - set(CLIPPABLE):
            raise ValueError(
                f"{', '.join(sorted(strange))}: no rule that clips; {', '.join(CLIPPABLE)} can"
            )
        self._last: _Taken | None = None

    def forget(self) -> None:
        """The stream has ended: the next step is a first one."""
        self._last = None

    def judge(self, target: Target, view: ArmView, at: int) -> Verdict:
        """Judge one step; nothing is remembered before `take`.

        Args:
            target: What the policy wants.
            view: The arm's newest cycle.
            at: When it would be sent [ns]; never earlier than the step before.
        """
        if self._last is not None and at - self._last.at > self._own.servo_timeout:
            self._last = None  # the arm has come to rest
        last = self._last
        before = last.target if last else Target(view.p_set, view.roll_set, view.jaw_set)
        since = (at - last.at if last else PERIOD) / SECOND
        found: list[Broken] = []
        for rule in RULES:
            broken = self._ask(rule, target, before, since, view)
            if broken is None:
                continue
            shorter = self._clipped(rule, target, before, since, view)
            if shorter is None:
                return Verdict(None, (broken,), np.zeros(3))
            found.append(broken)
            target = shorter
        return Verdict(target, tuple(found), (target.p - before.p) / since)

    def take(self, verdict: Verdict, at: int) -> None:
        """The step that was judged is sent."""
        assert verdict.target is not None
        self._last = _Taken(at, verdict.target, verdict.velocity)

    # --- rules ------------------------------------------------------------------------------------

    def _ask(
        self, rule: str, target: Target, before: Target, since: float, view: ArmView
    ) -> Broken | None:
        text: str = getattr(self, f"_{rule}")(target, before, since, view)
        return Broken(rule, f"{self._name}: {text}") if text else None

    def _not_finite(self, target: Target, before: Target, since: float, view: ArmView) -> str:
        del before, since, view
        return "" if np.isfinite(target.row).all() else f"{target.row.tolist()} is not finite"

    def _rcm_error(self, target: Target, before: Target, since: float, view: ArmView) -> str:
        del target, before, since
        limit = self._own.limits.rcm_error_warn
        if view.rcm_error <= limit:
            return ""
        return (
            f"the shaft is {1e3 * view.rcm_error:.2f} mm from its pivot; a policy may go on below "
            f"{1e3 * limit:g} mm"
        )

    def _workspace(self, target: Target, before: Target, since: float, view: ArmView) -> str:
        del before, since, view
        if surg_core.inside_workspace(self._own.limits, target.p):
            return ""
        beyond = surg_core.outside_workspace(self._own.limits, target.p)
        where = ", ".join(f"{1e3 * float(v):.4g}" for v in target.p)
        return (
            f"({where}) mm lies {1e3 * beyond:.4g} mm outside the workspace (metres in the rcm "
            "frame are meant)"
        )

    def _start(self, target: Target, before: Target, since: float, view: ArmView) -> str:
        if self._last is not None or self._near(target, before, since, begins=True):
            return ""
        limits = self._own.limits
        return (
            f"a stream begins within {1e3 * limits.step_slack:g} mm and "
            f"{math.degrees(limits.step_roll_slack):.2g} deg of the set-point, this is "
            f"{_apart(target, before)} from it"
        )

    def _step(self, target: Target, before: Target, since: float, view: ArmView) -> str:
        if self._last is None or self._near(target, before, since, begins=False):
            return ""
        limits = self._own.limits
        dt = min(since, limits.step_dt_max)
        far = limits.tip_velocity * dt + limits.step_slack
        turn = limits.roll_velocity * dt + limits.step_roll_slack
        return (
            f"{_apart(target, before)} after {1e3 * since:g} ms; allowed are {1e3 * far:.4g} mm "
            f"and {math.degrees(turn):.3g} deg"
        )

    def _near(self, target: Target, before: Target, since: float, begins: bool) -> bool:
        """The core's own test of a step."""
        distance = float(np.linalg.norm(target.p - before.p))
        turn = math.remainder(target.roll - before.roll, math.tau)
        reason = surg_core.check_step(self._own.limits, begins, since, distance, turn)
        return bool(reason == surg_core.Reason.NONE)

    def _acceleration(self, target: Target, before: Target, since: float, view: ArmView) -> str:
        if self._last is None:
            return ""
        # What the tip's limit allows in this time, and the slack that a step has too.
        limits = self._own.limits
        change = (target.p - before.p) / since - self._last.velocity
        allowed = limits.tip_acceleration * since + limits.step_slack / since
        if float(np.abs(change).max()) <= allowed:
            return ""
        return (
            f"the tip's velocity would change by {1e3 * float(np.abs(change).max()):.4g} mm/s "
            f"within {1e3 * since:g} ms; allowed are {1e3 * allowed:.4g} mm/s"
        )

    def _jaw(self, target: Target, before: Target, since: float, view: ArmView) -> str:
        del before, since, view
        low, high = self._own.jaw_min, self._own.jaw_max
        if low <= target.jaw <= high:
            return ""
        return f"jaw {target.jaw:.4g} rad; allowed are {low:g} to {high:g} rad"

    # --- clipping ---------------------------------------------------------------------------------

    def _clipped(
        self, rule: str, target: Target, before: Target, since: float, view: ArmView
    ) -> Target | None:
        """The step as far as the rule lets it; None: rejected."""
        if rule not in self._clip:
            return None
        if rule == "jaw":
            return self._clipped_jaw(target)
        low, high = 0.0, 1.0
        if self._ask(rule, before, before, since, view) is not None:
            return None  # it already stands where it must not
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            good = self._ask(rule, before.toward(target, middle), before, since, view) is None
            low, high = (middle, high) if good else (low, middle)
        return before.toward(target, low)

    def _clipped_jaw(self, target: Target) -> Target | None:
        """Into its range; further outside than the range is wide, no rounding explains it."""
        low, high = self._own.jaw_min, self._own.jaw_max
        if not low - (high - low) <= target.jaw <= high + (high - low):
            return None
        return Target(target.p, target.roll, min(max(target.jaw, low), high))


def _apart(target: Target, before: Target) -> str:
    distance = 1e3 * float(np.linalg.norm(target.p - before.p))
    turn = math.degrees(math.remainder(target.roll - before.roll, math.tau))
    return f"{distance:.4g} mm and {turn:.3g} deg"


class SafetyController:
    """Judges the steps of all arms that a policy commands: all pass, or nothing is sent.

    Args:
        arms: What the cell says of each, in the order of the action.
        clip: Rules that clip; the others reject.
    """

    def __init__(self, arms: Mapping[str, ArmLimits], clip: Iterable[str] = CLIPPED) -> None:
        clip = tuple(clip)
        self._arms = {name: ArmSafety(name, limits, clip) for name, limits in arms.items()}

    def forget(self) -> None:
        """The stream has ended: the next step is a first one."""
        for arm in self._arms.values():
            arm.forget()

    def judge(
        self, targets: Mapping[str, Target], views: Mapping[str, ArmView], at: int
    ) -> tuple[dict[str, Target], tuple[Broken, ...]]:
        """Judge one step of all arms.

        Args:
            targets: What the policy wants, by arm.
            views: The newest cycle of each.
            at: When it would be sent [ns].

        Returns:
            What may be sent, by arm (empty: rejected), and the rules that clipped or rejected it.
        """
        verdicts = {n: arm.judge(targets[n], views[n], at) for n, arm in self._arms.items()}
        refusals = [v.broken for v in verdicts.values() if v.target is None]
        if refusals:
            return {}, tuple(broken for each in refusals for broken in each)
        passed: dict[str, Target] = {}
        for name, verdict in verdicts.items():
            self._arms[name].take(verdict, at)
            if verdict.target is not None:
                passed[name] = verdict.target
        return passed, tuple(broken for v in verdicts.values() for broken in v.broken)
