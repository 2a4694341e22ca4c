"""The model server without sockets, topics and clocks: messages in, replies and commands out.

========  =====================================  =================================================
state     meaning                                left by
========  =====================================  =================================================
IDLE      no policy is connected                 HELLO: READY
READY     a policy is connected, not enabled     enable: WAKING
WAKING    the arms are being enabled, claimed    arms held: RUNNING; failure, timeout: PAUSED
RUNNING   the policy moves the arms              obstacle, lost arm, rejects, no steps: PAUSED
PAUSED    stopped; ``reason`` says why           enable: WAKING; disable: READY
========  =====================================  =================================================

The end of the session leads to IDLE from every state. Only RUNNING moves an arm, and every way out
of it pauses the arms that the policy held.

Two times are arguments. ``now`` is the steady clock: timeouts of the client and round trips. ``at``
is the time of the execution: ages of observations and due steps. In free-run they are equal; in
lock-step ``at`` is the simulated time, so a roll-out does not depend on computing time.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from surg_core.arm_view import ArmCommands, ArmView
from surg_core.contract import SECOND_NS
from surg_policy_bridge.server import server_replies
from surg_policy_bridge.server.arm_authority import ArmAuthority, Phase
from surg_policy_bridge.server.counters import Counters
from surg_policy_bridge.server.observer import Observation
from surg_policy_bridge.server.policy_arm import Target
from surg_policy_bridge.server.policy_plan import PolicyPlan, shown_rows
from surg_policy_bridge.server.safety_controller import SafetyController
from surg_policy_bridge.server.sessions import (
    PolicySession,
    SentObservation,
    in_space_of,
    refusal,
    spec_for,
)
from surg_policy_bridge.server.step_executor import StepExecutor
from surg_policy_bridge.server.stop_reason import StopReason
from surg_policy_bridge.server.timers import EMPTY, MAX_OBS_AGE, REJECTS, SILENCE, Timeout
from surg_policy_client import wire
from surg_policy_client.spec import Spec
from surg_policy_client.wire import Message, WireError

VERSIONS = range(1, wire.VERSION + 1)
"""Protocol versions that this server speaks."""


class ServerState(enum.Enum):
    """What the policy does to the arms."""

    IDLE = "IDLE"
    READY = "READY"
    WAKING = "WAKING"
    RUNNING = "RUNNING"
    PAUSED = "PAUSED"


ACTIVE = (ServerState.WAKING, ServerState.RUNNING)
"""States in which the policy holds arms, or is about to."""


@dataclass(frozen=True)
class ServerSettings:
    """Constants of one server."""

    arms: tuple[str, ...]  # arms that the policy commands, in the order of the action
    node: str  # caller id under which commands are sent
    instruction: str = ""  # the task in words
    autostart: bool = False  # enable every new session at once, for runs without an operator
    silence: int = SILENCE  # timeout of the client [ns]
    # a step is executed only while its observation is not older [ns]
    max_obs_age: int = MAX_OBS_AGE
    empty: int = EMPTY  # the arms are paused after this time without a step [ns]


class ModelServer:
    """One policy on the arms of one cell.

    Args:
        settings: Constants.
        safety: Judges every step.
        new_session: Random number of a session, 1 to 2**64 - 1.

    Attributes:
        state: What the policy does to the arms.
        cause: Why it is neither RUNNING nor WAKING.
        reason: The same in words; empty while it is RUNNING.
        session: Of the connected policy; None: no policy is connected.
        waiting: A policy is in session or waits for the specification; it was not refused.
        counters: Statistics.
        replies: Messages to send, with the peer; the caller empties it.
        episode: Number of the episode.
    """

    def __init__(
        self,
        settings: ServerSettings,
        safety: SafetyController,
        new_session: Callable[[], int],
    ) -> None:
        self._settings, self._new_session = settings, new_session
        self._authority = ArmAuthority(settings.arms, settings.node)
        self._spec: Spec | None = None
        self._early_hello: tuple[bytes, dict[str, Any]] | None = None
        self._obstacle = ""
        self._observation_problem = ""
        self._views: Mapping[str, ArmView] = {}
        self._at = 0
        self._start_pending = False
        self._episode_open = False
        self._plan: PolicyPlan | None = None
        self.state = ServerState.IDLE
        self.cause, self.reason = StopReason.NO_POLICY, "no policy is connected"
        self.session: PolicySession | None = None
        self.waiting = False
        self.counters = Counters()
        self.steps = StepExecutor(
            settings.arms, safety, self.counters, settings.max_obs_age, settings.empty
        )
        self.replies: list[tuple[bytes, Message]] = []
        self.episode = 0

    # --- operator, task and arms ------------------------------------------------------------------

    def serve(self, spec: Spec, now: int) -> None:
        """Set the specification; a HELLO that came before it is answered now."""
        self._spec = spec
        if self._early_hello is not None:
            hello, self._early_hello, self.waiting = self._early_hello, None, False
            self._hello(*hello, now)

    def enable(self, on: bool, at: int) -> str:
        """Start or stop the policy; returns why it does not start."""
        self._start_pending = False
        if not on:
            if self.state in ACTIVE:
                self._stop(ServerState.READY, StopReason.NOT_ENABLED, "not enabled")
            elif self.state is ServerState.PAUSED:
                self._set_state(ServerState.READY, StopReason.NOT_ENABLED, "not enabled")
            return ""
        if self.state in ACTIVE:
            return ""
        if self.session is None:
            return "no policy is connected; start one, it connects by itself"
        if obstacle := self._obstacle or self._authority.obstacle(self._views):
            return obstacle
        self._authority.acquire(at)
        self._set_state(ServerState.WAKING, StopReason.NONE, "the arms are being enabled")
        return ""

    def episode_over(self, success: bool | None, reason: str) -> None:
        """The task has ended."""
        if self._episode_open:
            self._episode_open = False
            self._send_episode("end", success, reason)
        if self.state in ACTIVE:
            self._stop(ServerState.READY, StopReason.EPISODE_OVER, "the episode is over")

    def end(self, reason: str) -> None:
        """End the server: pause the arms and tell the policy."""
        if self.state in ACTIVE:
            self._stop(ServerState.PAUSED, StopReason.SERVER_ENDED, reason)
        if self.session is not None:
            farewell = {"session": self.session.number, "reason": reason}
            self._send(self.session.peer, Message("BYE", farewell))
        self._forget_session(StopReason.SERVER_ENDED, "the server has ended")

    def tick(
        self,
        views: Mapping[str, ArmView],
        at: int,
        now: int,
        obstacle: str = "",
        camera_problem: str = "",
        cause: StopReason = StopReason.OPERATOR,
    ) -> dict[str, ArmCommands]:
        """Evaluate arms and timeouts; call it whenever there is anything new.

        Args:
            views: Newest cycle of every arm that is not silent.
            at: Time of the execution [ns].
            now: Steady clock [ns].
            obstacle: Why no policy may run: the operator drives an arm, or nobody is at the
                controls. Clearing it starts nothing.
            camera_problem: Which camera shows nothing new. It stops a policy, but a pending start
                waits for it, as it waits for an arm that has not sent yet.
            cause: Of the obstacle.

        Returns:
            Commands besides the steps, by arm.
        """
        self._views, self._at, self._obstacle = views, at, obstacle or camera_problem
        cause = cause if obstacle else StopReason.CAMERA
        if self._obstacle and self.state in ACTIVE:
            self._stop(ServerState.PAUSED, cause, self._obstacle)
        if self.session is not None and self.session.silence.exceeded(now):
            limit_ms = 1e-6 * self._settings.silence
            silent = f"the policy has been silent for more than {limit_ms:.0f} ms"
            self._lose_session(StopReason.POLICY_SILENT, silent)
        if self._start_pending and self.session is not None:
            refused = self.enable(True, at)
            if refused:
                cause = cause if self._obstacle else StopReason.ARM
                self._set_state(self.state, cause, refused)
            # Arms and cameras may still come up; what needs a person ends the pending start.
            coming_up = bool(camera_problem) or any(arm not in views for arm in self._settings.arms)
            self._start_pending = bool(refused) and not obstacle and coming_up
        if lost := self._authority.monitor(views, at):
            self._stop(ServerState.PAUSED, StopReason.ARM, lost)
        elif self.state is ServerState.WAKING and self._authority.phase is Phase.HELD:
            self._run()
        return self._authority.take_commands()

    # --- observations and steps -------------------------------------------------------------------

    def observe(self, observation: Observation, at: int, now: int) -> None:
        """Send an observation with all keys of `wanted` to the running policy.

        It was taken at ``at``; ``now`` is the steady clock [ns].
        """
        session = self.session
        if session is None or self.state is not ServerState.RUNNING:
            return
        self._observation_problem = ""
        seq = session.note(SentObservation(observation.stamp_ns, observation.step, at, now))
        head = {
            "session": session.number,
            "seq": seq,
            "stamp_ns": observation.stamp_ns,
            "episode": self.episode,
            "step": observation.step,
            "instruction": self._settings.instruction,
        }
        arrays = {key: observation.arrays[key] for key in session.spec.observation}
        self._send(session.peer, Message("OBS", head, arrays))

    def observe_nothing(self, reason: str) -> None:
        """There is no observation at this grid time."""
        self._observation_problem = reason

    @property
    def wanted(self) -> tuple[str, ...]:
        """Keys of the observations of the connected policy."""
        return tuple(self.session.spec.observation) if self.session is not None else ()

    @property
    def unanswered(self) -> bool:
        """The newest observation has no answer yet."""
        session = self.session
        return (
            self.state is ServerState.RUNNING
            and session is not None
            and session.answered < session.seq
        )

    def execute(self, number: int, at: int, past: int | None = None) -> dict[str, Target]:
        """The step that brings the arms to their targets of a grid time.

        Args:
            number: Of the grid time.
            at: When it is sent, or begins to be played [ns].
            past: Steps up to this one are late from now on; default: ``number``.

        Returns:
            Targets to send, by arm; empty: none.
        """
        self._at = at
        session = self.session
        if self.state is not ServerState.RUNNING or session is None:
            self.steps.queue.take(number, past)
            return {}
        step = self.steps.take(number, past, at)
        if step is None:
            if self.steps.starved(at):
                self._stop(ServerState.PAUSED, *self._starvation())
            return {}
        targets = self.steps.judge(session, step, self._views, at)
        if not targets:
            self._pause_after_rejects()
            self._acknowledge(step.seq)
        return targets

    def _starvation(self) -> tuple[StopReason, str]:
        limit = self._settings.empty / SECOND_NS
        if problem := self._observation_problem:
            text = f"no observation for more than {limit:g} s: {problem}"
            return StopReason.NO_OBSERVATION, text
        return StopReason.NO_ACTION, f"the policy has sent no action for more than {limit:g} s"

    def _pause_after_rejects(self) -> None:
        if self.steps.rejected_in_a_row >= REJECTS and self.state is ServerState.RUNNING:
            text = f"{REJECTS} rejected steps in a row; the last: {self.steps.judged[-1].text}"
            self._stop(ServerState.PAUSED, StopReason.REJECTED, text)

    # --- states -----------------------------------------------------------------------------------

    def _run(self) -> None:
        """The arms are held; answers to earlier observations are too late."""
        self._set_state(ServerState.RUNNING, StopReason.NONE, "")
        if self.session is not None:
            self.session.answered = self.session.seq
        self.steps.start(self._at)
        if self._episode_open:
            self._send_episode("resumed", None, "")
        else:
            self._episode_open = True
            self.episode += 1
            self.steps.begin_episode()
            self._send_episode("begin", None, "")

    def _set_state(self, state: ServerState, cause: StopReason, reason: str) -> None:
        self.state, self.cause, self.reason = state, cause, reason

    def _stop(self, state: ServerState, cause: StopReason, reason: str) -> None:
        """Execute nothing that is queued, and pause the arms that are held."""
        self.steps.stop()
        self._authority.release(self._views)
        self._set_state(state, cause, reason)
        if self.session is not None and self.steps.has_unreported_rejections:
            self._acknowledge(self.session.answered)
        if self._episode_open:
            self._send_episode("paused", None, reason)

    def _lose_session(self, cause: StopReason, reason: str) -> None:
        if self.state in ACTIVE:
            self._stop(ServerState.PAUSED, cause, reason)
        self._forget_session(cause, reason)

    def _forget_session(self, cause: StopReason, reason: str) -> None:
        self.session, self._start_pending = None, False
        self._set_state(ServerState.IDLE, cause, f"{reason}; no policy is connected")

    # --- messages of the policy -------------------------------------------------------------------

    def receive(self, peer: bytes, message: Message, now: int) -> None:
        """Take in a message of a connection; ``now`` is the steady clock [ns]."""
        if message.kind == "HELLO":
            self._hello(peer, message.head, now)
            return
        session = self.session
        if session is None or peer != session.peer or message.head.get("session") != session.number:
            self.counters.strangers += 1
            self._refuse(peer, "session", "there is no such session; send HELLO first")
            return
        session.heard(now)
        if message.kind == "PING":
            self._send(peer, Message("PONG", dict(message.head)))
        elif message.kind == "ACT":
            self._act(session, message, now)
        elif message.kind == "RESET":
            self._reset(session)
        elif message.kind == "BYE":
            reason = message.head["reason"] or "no reason given"
            left = f"the policy has disconnected: {reason}"
            self._lose_session(StopReason.POLICY_LEFT, left)
        else:
            self._refuse(peer, "kind", f"{message.kind} is a message of the server")

    def refuse_malformed(self, peer: bytes, error: WireError) -> None:
        """Frames that are no message: the policy in session is told, a stranger is ignored."""
        self.counters.malformed[error.code] += 1
        session = self.session
        if session is None or peer != session.peer:
            return
        if error.code == "finite" and self.state is ServerState.RUNNING:
            self.steps.reject(session, 0, "not_finite", str(error), self._at)
            self._pause_after_rejects()
            self._acknowledge(session.answered)
        else:
            self._refuse(peer, error.code, str(error))

    def _hello(self, peer: bytes, head: dict[str, Any], now: int) -> None:
        session = self.session
        if session is not None and session.peer == peer:
            session.heard(now)
            self._welcome(session)  # its HELLO crossed the answer
            return
        if session is not None and not session.silence.exceeded(now):
            name = session.policy or session.client
            self._refuse(peer, "busy", f"{name} is connected; one policy at a time")
            return
        if session is not None:
            self._lose_session(StopReason.POLICY_SILENT, "the policy is silent")
        if self._spec is None:
            self._early_hello, self.waiting = (peer, head), True
            return
        spec = in_space_of(head, self._spec, self._settings.arms)
        if refused := refusal(head, VERSIONS, spec):
            self._refuse(peer, *refused)
        else:
            self._open_session(peer, head, spec, now)

    def _open_session(self, peer: bytes, head: dict[str, Any], spec: Spec, now: int) -> None:
        self.session = PolicySession(
            number=self._new_session(),
            peer=peer,
            client=head["client"],
            policy=head["policy"],
            spec=spec_for(head, spec),
            silence=Timeout(self._settings.silence, now),
            version=min(head["versions"][1], wire.VERSION),
        )
        self.waiting = True
        self.counters.sessions += 1
        self.steps.take_tally()
        if self.state is ServerState.IDLE:
            self._set_state(ServerState.READY, StopReason.NOT_ENABLED, "not enabled")
        self._start_pending = self._settings.autostart
        self._welcome(self.session)

    def _reset(self, session: PolicySession) -> None:
        """Granted where nothing has moved yet; else episodes begin on the server's side."""
        if self.state is ServerState.RUNNING and not session.acted:
            return
        self._refuse(
            session.peer,
            "reset",
            "episodes begin on the server's side: ./surg run begins the next one by itself; "
            "otherwise publish true on /policy/enable when the scene is ready",
        )

    def _act(self, session: PolicySession, message: Message, now: int) -> None:
        head, rows = message.head, message.arrays["chunk"]
        seq, first = head["seq"], head["step0"]
        sent = session.sent.get(seq)
        if sent is None or sent.stamp_ns != head["stamp_ns"]:
            text = f"observation {seq} of stamp {head['stamp_ns']} was never sent, or long ago"
            self.steps.reject(session, first, "observation", text, self._at)
        elif seq <= session.answered or self.state is not ServerState.RUNNING:
            self.steps.count_stale(len(rows))
        else:
            session.answered, session.acted = seq, True
            self.counters.round_trip.add(now - sent.sent)
            before = self.steps.last_rejected
            self.steps.splice(session, first, rows, seq, sent, self._views, self._at)
            if self.steps.last_rejected is before:
                self._note_plan(session, message, sent)
        self._pause_after_rejects()
        self._acknowledge(seq)

    def _note_plan(self, session: PolicySession, message: Message, sent: SentObservation) -> None:
        """Keep for people what the policy plans and sees. Nothing else reads it."""
        if message.unseen:
            self.counters.malformed["seen"] += 1
        # Of the queue, not of this chunk: one without rows may have any width.
        width = len(self.action_names)
        first, rows = self.steps.queue.ahead(shown_rows(width))
        self._plan = PolicyPlan(
            session=session.number,
            seq=message.head["seq"],
            stamp_ns=sent.stamp_ns,
            first=first,
            rows=self.steps.shown_rows(np.array(rows)).reshape(len(rows), width),
            seen=message.seen,
            unseen=message.unseen,
        )

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the numbers of what is shown of steps."""
        return self.steps.shown.columns(self._settings.arms)

    def take_plan(self) -> PolicyPlan | None:
        """What the policy plans and sees by its newest answer; once for each answer."""
        plan, self._plan = self._plan, None
        return plan

    # --- replies ----------------------------------------------------------------------------------

    def _send(self, peer: bytes, message: Message) -> None:
        self.replies.append((peer, message))

    def _refuse(self, peer: bytes, code: str, text: str) -> None:
        self._send(peer, Message("ERR", {"code": code, "text": text}))

    def _welcome(self, session: PolicySession) -> None:
        settings = self._settings
        reply = server_replies.welcome(session, settings.max_obs_age, settings.silence)
        self._send(session.peer, reply)

    def _acknowledge(self, seq: int) -> None:
        session = self.session
        if session is not None:
            tally, queued = self.steps.take_tally(), len(self.steps.queue)
            reply = server_replies.acknowledgement(session, seq, tally, queued)
            self._send(session.peer, reply)

    def _send_episode(self, event: str, success: bool | None, reason: str) -> None:
        session, instruction = self.session, self._settings.instruction
        if session is not None:
            number = self.episode
            reply = server_replies.episode(session, number, event, instruction, success, reason)
            self._send(session.peer, reply)
