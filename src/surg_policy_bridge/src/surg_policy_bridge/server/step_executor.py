"""Executes the steps of a policy: queue, safety controller, and what becomes of every step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surg_core import action_space
from surg_core.action_space import ActionSpace
from surg_core.arm_view import ArmView
from surg_core.contract import STEP, STEP_NS
from surg_policy_bridge.server.chunk_queue import ActionStep, ChunkQueue, plan_shares
from surg_policy_bridge.server.counters import Counters
from surg_policy_bridge.server.policy_arm import Target
from surg_policy_bridge.server.safety_controller import SafetyController
from surg_policy_bridge.server.server_replies import rejected_step
from surg_policy_bridge.server.sessions import PolicySession, SentObservation
from surg_policy_bridge.server.swing_watch import SwingWatch
from surg_policy_bridge.server.timers import Timeout

Array = NDArray[np.float64]

TOLD = ("accepted", "clipped", "late", "stale")
"""Counts of steps that an ACK states, since the one before."""
KEPT = 64
"""Targets sent that a relative step may refer to."""


@dataclass(frozen=True)
class JudgedStep:
    """One step with the verdict of the safety controller."""

    session: int  # of the policy
    seq: int  # of the observation that it answers
    step: int  # its grid time
    obs_age: int  # age of that observation [ns]
    values: Array  # what was relayed or, if rejected, requested; (A,), may be empty
    passed: bool  # it was relayed
    rule: str = ""  # rules that clipped or rejected it; empty: none
    text: str = ""  # what was requested and what is allowed


class StepExecutor:
    """Steps of one policy on their way to the arms, which are in the order of the action.

    A step is executed only while its observation is not older than ``max_obs_age`` [ns]; ``empty``
    is the longest time without a step [ns]. ``judged`` holds steps for the topics; the caller
    empties it. ``last_rejected`` is the newest rejected step of the episode.
    """

    def __init__(
        self,
        arms: tuple[str, ...],
        safety: SafetyController,
        counters: Counters,
        max_obs_age: int,
        empty: int,
    ) -> None:
        self._arms, self._safety, self._counters = arms, safety, counters
        self._max_obs_age = max_obs_age
        self._empty = Timeout(empty)
        self._told = dict.fromkeys(TOLD, 0)
        self._refused: list[dict[str, Any]] = []
        self.queue = ChunkQueue()
        self.swings = SwingWatch(arms)
        self.judged: list[JudgedStep] = []
        self.last_rejected: JudgedStep | None = None
        self.rejected_in_a_row = 0
        self.shown = ActionSpace()
        """Names of the numbers of what is shown of steps; with the arms' wrists."""
        self._sent: dict[int, Array] = {}

    def start(self, at: int) -> None:
        """The policy begins to run; the next step starts a stream."""
        self.stop()
        self.rejected_in_a_row = 0
        self._empty.start(at)

    def begin_episode(self) -> None:
        """An episode begins; what was rejected before does not concern it."""
        self.last_rejected = None
        self.swings.start()

    def stop(self) -> None:
        """The policy does not run any more; nothing queued is executed."""
        self.queue.flush()
        self._safety.forget()
        self._sent.clear()
        self._empty.clear()

    def take(self, number: int, past: int | None, at: int) -> ActionStep | None:
        """The step of a grid time; see :meth:`ChunkQueue.take`."""
        self.count_stale(self.queue.drop_older(at - self._max_obs_age))
        step = self.queue.take(number, past)
        if step is None:
            self._counters.empty += 1
            self._empty.start(at)
        else:
            self._empty.clear()
        return step

    def starved(self, at: int) -> bool:
        """Whether there has been no step for too long."""
        return self._empty.exceeded(at)

    def coming(self, number: int) -> dict[str, Target] | None:
        """Targets of a future grid time, by arm; None: unknown."""
        step = self.queue.peek(number)
        return None if step is None else self._targets(step.row)

    def judge(
        self, session: PolicySession, step: ActionStep, views: Mapping[str, ArmView], at: int
    ) -> dict[str, Target]:
        """What may be sent of a step, by arm; empty: it is rejected."""
        at_rest = not self._safety.streaming(at)
        passed, violations = self._safety.judge(self._targets(step.row), views, at)
        if not passed:
            worst = violations[0]
            self.reject(session, step.number, worst.rule, worst.text, at, step.seq, step.row)
            return {}
        self.rejected_in_a_row = 0
        values = np.concatenate([target.row for target in passed.values()])
        if at_rest:  # targets of an earlier stream are no reference in this one
            self._sent = {step.number - 1: self._held(views)}
        self._sent[step.number] = values
        if len(self._sent) > KEPT:  # by their count: not every number was sent
            del self._sent[min(self._sent)]
        self.swings.take(np.array([target.p for target in passed.values()]), at)
        self._counters.accepted += 1
        self._counters.obs_age.add(at - step.seen)
        self._counters.clipped += bool(violations)
        self.judged.append(
            JudgedStep(
                session=session.number,
                seq=step.seq,
                step=step.number,
                obs_age=at - step.seen,
                values=self.shown_rows(values[None]).ravel(),
                passed=True,
                rule=",".join(violation.rule for violation in violations),
                text="; ".join(violation.text for violation in violations),
            )
        )
        return passed

    def reject(
        self,
        session: PolicySession,
        number: int,
        rule: str,
        text: str,
        at: int,
        seq: int = 0,
        values: Array | None = None,
    ) -> None:
        """A rule refuses the step of a grid time; ``at`` is the time of the execution [ns]."""
        sent = session.sent.get(seq)
        age = at - sent.seen if sent is not None else 0
        row = np.zeros(0) if values is None else self.shown_rows(values[None]).ravel()
        self._counters.rejected[rule] += 1
        self.last_rejected = JudgedStep(session.number, seq, number, age, row, False, rule, text)
        self.judged.append(self.last_rejected)
        self._refused.append(rejected_step(number, rule, text))
        self.rejected_in_a_row += 1

    def splice(
        self,
        session: PolicySession,
        first: int,
        rows: Array,
        seq: int,
        sent: SentObservation,
        views: Mapping[str, ArmView],
        at: int,
    ) -> None:
        """Queue a chunk (K, A) that answers an observation, or refuse it if its shape is wrong.

        It is in the action space of the session; the queue holds absolute targets.
        """
        if at - sent.seen > self._max_obs_age:
            self.count_stale(len(rows))
        elif len(rows) and (wrong := session.spec.check_chunk(rows)):
            self.reject(session, first, "shape", "; ".join(wrong), at, seq)
        elif len(rows):
            at_rest = not self._safety.streaming(at)
            space = self._space(session, views)
            if space is None:
                changed = "another instrument has been mounted: connect the policy again"
                self.reject(session, first, "shape", changed, at, seq)
                return
            if not space.is_target:
                rows = space.decode(rows, self._before(first, views, at_rest), STEP)
            if not np.isfinite(rows).all():  # a sum of finite relative steps may be none
                text = "the steps add up to infinity, or lead where no wrist can be"
                self.reject(session, first, "not_finite", text, at, seq)
                return
            rows = rows if at_rest else self._joined(first, rows)
            self._counters.late += self.queue.splice(first, rows, seq, sent.seen, at_rest)

    def _space(self, session: PolicySession, views: Mapping[str, ArmView]) -> ActionSpace | None:
        """That of the session; None: the arms hold other instruments than at its beginning."""
        if all(arm in views for arm in self._arms):
            self.shown = ActionSpace(wrists=tuple(views[arm].wrist_geometry for arm in self._arms))
        action = session.spec.action
        if action is None:
            return self.shown
        return action_space.of_columns(action.names, self._arms, self.shown.wrists)

    def _joined(self, first: int, rows: Array) -> Array:
        """A chunk of targets (K, T) that goes on from what is being executed.

        It takes over by `plan_shares` while its rows last, and within ``max_obs_age``: 12 steps. In
        4 steps a policy that answers 250 ms late solved 0 of 6 `bgr`, in these 6 of 6. One that is
        in time goes on by itself, and stays as it is.
        """
        if not self.queue.late(first, len(rows)) or not self._sent:
            return rows
        begun = self.queue.next - first
        coming = rows[begun : begun + self._max_obs_age // STEP_NS]
        plan = self.queue.plan(len(coming), self._sent[max(self._sent)])
        rows = np.array(rows, dtype=np.float64)
        for i, share in enumerate(plan_shares(len(coming))):
            before, after = self._targets(plan[i]), self._targets(coming[i])
            mixed = [after[arm].toward(before[arm], share).row for arm in self._arms]
            rows[begun + i] = np.concatenate(mixed)
        return rows

    def _before(self, first: int, views: Mapping[str, ArmView], at_rest: bool) -> Array:
        """The target (A,) to which a relative step refers: that of the step before.

        If that one was neither queued nor sent, the newest target that the stream sent before. At
        rest the set-point: after a gap the controller has stopped the arm, and the step starts a
        stream.
        """
        queued = self.queue.peek(first - 1)
        if queued is not None:
            return queued.row
        earlier = [] if at_rest else [number for number in self._sent if number < first]
        return self._sent[max(earlier)] if earlier else self._held(views)

    def _held(self, views: Mapping[str, ArmView]) -> Array:
        """The set-points of the arms, (A,)."""
        return np.concatenate([views[arm].held_target for arm in self._arms])

    def count_stale(self, steps: int) -> None:
        """So many steps answered an observation that was too old."""
        self._counters.stale += steps

    def take_tally(self) -> dict[str, Any]:
        """What the next ACK reports; the count starts again."""
        counts = {name: getattr(self._counters, name) for name in TOLD}
        tally = {name: count - self._told[name] for name, count in counts.items()}
        self._told, refused, self._refused = counts, self._refused, []
        return {**tally, "rejected": refused}

    @property
    def has_unreported_rejections(self) -> bool:
        """Whether the next ACK reports a rejection."""
        return bool(self._refused)

    def _targets(self, row: Array) -> dict[str, Target]:
        parts = self.shown.split(row)
        wrists = self.shown.wrists or (None,) * len(self._arms)
        named = zip(self._arms, parts, wrists, strict=True)
        return {name: Target.of(part, wrist) for name, part, wrist in named}

    def shown_rows(self, targets: Array) -> Array:
        """Targets (K, T) as people and clients know them: absolute actions (K, A).

        Without a row where a target is none.
        """
        if self.shown.is_target:
            return targets
        if not len(targets) or not np.isfinite(targets).all():
            return np.zeros((0, len(self.shown.columns(self._arms))))
        return self.shown.encode(targets, targets, STEP)
