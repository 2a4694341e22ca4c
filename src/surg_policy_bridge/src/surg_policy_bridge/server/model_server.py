"""The model server without sockets, topics and clocks: frames in, frames and commands out.

Two times are arguments: ``now`` of the steady clock, by which the client's silence and the round
trip are measured, and ``at`` of the execution, by which observations age and steps are due. In
free-run they are the same; in lock-step ``at`` is the simulated time, so that a roll-out does not
depend on how long anybody took.

States: IDLE (no policy), READY (one is connected and not enabled), WAKING (the arms are being
enabled and claimed), RUNNING, PAUSED (it was stopped; `reason` says why). Only RUNNING moves an
arm, and every way out of it pauses what was held.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surg_policy_bridge.server.chunk_queue import ChunkQueue, Step
from surg_policy_bridge.server.counters import Counters
from surg_policy_bridge.server.handover import Handover, Phase
from surg_policy_bridge.server.observer import Observation
from surg_policy_bridge.server.policy_arm import ACTION, PERIOD, SECOND, ArmCommand, ArmView, Target
from surg_policy_bridge.server.safety_controller import SafetyController
from surg_policy_bridge.server.sessions import Flow, Sent, Session, refusal, spec_for
from surg_policy_bridge.server.timers import EMPTY, MAX_OBS_AGE, REJECTS, SILENCE, Patience
from surg_policy_client import wire
from surg_policy_client.spec import Spec
from surg_policy_client.wire import Message, WireError

PING = 50_000_000
"""[ns] How often a client is asked to ping."""
VERSIONS = range(wire.VERSION, wire.VERSION + 1)
"""Of the protocol that this server speaks."""

Array = NDArray[np.float64]


class State(enum.Enum):
    """What the policy does to the arms."""

    IDLE = "IDLE"
    READY = "READY"
    WAKING = "WAKING"
    RUNNING = "RUNNING"
    PAUSED = "PAUSED"


@dataclass(frozen=True)
class ServerSettings:
    """What is fixed for one server.

    Attributes:
        arms: Those that the policy commands, in the order of the action.
        node: Caller id under which commands are sent.
        instruction: What the policy shall do, in words.
        autostart: Every new session is enabled at once, as a run without an operator needs it.
        silence: A client that has not been heard for longer is lost [ns].
        max_obs_age: A step is executed only while its observation is not older [ns].
        empty: Without a step for longer, the arms are paused [ns].
    """

    arms: tuple[str, ...]
    node: str
    instruction: str = ""
    autostart: bool = False
    silence: int = SILENCE
    max_obs_age: int = MAX_OBS_AGE
    empty: int = EMPTY


@dataclass(frozen=True)
class Judged:
    """One step as the safety controller judged it.

    Attributes:
        session: Of the policy.
        seq: Of the observation that it answers.
        step: Its grid time.
        obs_age: Of that observation [ns].
        values: What was relayed or, where it was rejected, what was asked for; (A,), may be empty.
        passed: It was relayed.
        rule: That clipped or rejected it; empty: none.
        text: What was asked for, what is allowed.
    """

    session: int
    seq: int
    step: int
    obs_age: int
    values: Array
    passed: bool
    rule: str = ""
    text: str = ""


@dataclass
class _Told:
    """What the next ACK tells the client."""

    accepted: int = 0
    clipped: int = 0
    late: int = 0
    stale: int = 0
    rejected: list[dict[str, Any]] = field(default_factory=list)


class ModelServer:
    """One policy on the arms of one cell.

    Args:
        settings: What is fixed.
        safety: Judges every step.
        draw: Gives the random number of a session, 1 to 2**64 - 1.

    Attributes:
        state: What the policy does to the arms.
        reason: Why it is not RUNNING; empty while it is.
        session: The policy that is connected; None: there is none.
        waiting: A policy has come, in session or for the specification; not one that was refused.
        counters: What was counted.
        outbox: Frames to send, with the peer; the caller empties it.
        judged: Steps for the topics; the caller empties it.
        episode: Number of the episode.
    """

    def __init__(
        self, settings: ServerSettings, safety: SafetyController, draw: Callable[[], int]
    ) -> None:
        self._settings, self._safety, self._draw = settings, safety, draw
        self._handover = Handover(settings.arms, settings.node)
        self._flow = Flow()
        self._queue = ChunkQueue()
        self._empty = Patience(settings.empty)
        self._spec: Spec | None = None
        self._early: tuple[bytes, dict[str, Any]] | None = None
        self._obstacle = ""
        self._blind = ""
        self._views: Mapping[str, ArmView] = {}
        self._told = _Told()
        self._in_a_row = 0
        self._at = 0
        self._start = False
        self._open = False
        self.state = State.IDLE
        self.reason = "no policy is connected"
        self.session: Session | None = None
        self.waiting = False
        self.counters = Counters()
        self.outbox: list[tuple[bytes, list[Any]]] = []
        self.judged: list[Judged] = []
        self.episode = 0

    # --- what happens around it -------------------------------------------------------------------

    def serve(self, spec: Spec, now: int) -> None:
        """From now on this is observed and commanded; a HELLO that came before is answered now."""
        self._spec = spec
        if self._early is not None:
            early, self._early, self.waiting = self._early, None, False
            self._hello(*early, now)

    def enable(self, on: bool, at: int) -> str:
        """Somebody wants the policy to run, or to stop.

        Returns:
            Why it does not; empty otherwise.
        """
        self._start = False
        if not on:
            if self.state in (State.WAKING, State.RUNNING):
                self._stop(State.READY, "not enabled")
            elif self.state is State.PAUSED:
                self.state, self.reason = State.READY, "not enabled"
            return ""
        if self.state in (State.WAKING, State.RUNNING):
            return ""
        if self.session is None:
            return "no policy is connected: start one, it connects by itself"
        if obstacle := self._obstacle or self._handover.obstacle(self._views):
            return obstacle
        self._handover.ask(at)
        self.state, self.reason = State.WAKING, "the arms are being enabled"
        return ""

    def episode_over(self, success: bool | None, reason: str) -> None:
        """The task is done, or given up."""
        if self._open:
            self._open = False
            self._say_episode("end", success, reason)
        if self.state in (State.WAKING, State.RUNNING):
            self._stop(State.READY, "the episode is over")

    def end(self, reason: str) -> None:
        """The server ends: whoever is connected is told, what is held is paused."""
        if self.state in (State.WAKING, State.RUNNING):
            self._stop(State.PAUSED, reason)
        if self.session is not None:
            self._send(self.session.peer, "BYE", session=self.session.number, reason=reason)
        self._forget("the server has ended")

    def tick(
        self,
        views: Mapping[str, ArmView],
        at: int,
        now: int,
        obstacle: str = "",
        blind: str = "",
    ) -> dict[str, ArmCommand]:
        """Look at the arms and at the timers; as often as there is anything new.

        Args:
            views: Newest cycle of every arm that has spoken lately.
            at: Time of the execution [ns].
            now: Steady clock [ns].
            obstacle: Why somebody wants no policy to run now: an operator's hand is on an arm, or
                nobody is at the controls; empty: one may. Taking it away starts nothing.
            blind: Which camera shows nothing new; empty: none. It stops a policy, too, but a start
                waits for it, as for an arm that has not spoken yet.

        Returns:
            What the arms have to be told besides the steps, by name.
        """
        self._views, self._at, self._obstacle = views, at, obstacle or blind
        if self._obstacle and self.state in (State.WAKING, State.RUNNING):
            self._stop(State.PAUSED, self._obstacle)
        session = self.session
        if session is not None and session.silence.exceeded(now):
            silent = 1e-6 * self._settings.silence
            self._lose(f"the policy has been silent for more than {silent:.0f} ms")
        if self._start and self.session is not None:
            refused = self.enable(True, at)
            self.reason = refused or self.reason
            # What is still to come is waited for; what a person has or has to see to is not.
            coming = bool(blind) or any(arm not in views for arm in self._settings.arms)
            self._start = bool(refused) and not obstacle and coming
        if trouble := self._handover.look(views, at):
            self._stop(State.PAUSED, trouble)
        elif self.state is State.WAKING and self._handover.phase is Phase.HELD:
            self._run()
        return self._handover.commands(views, at)

    # --- observations and steps -------------------------------------------------------------------

    def observe(self, observation: Observation, at: int, now: int) -> None:
        """Send an observation to a policy that is running.

        Args:
            observation: All that the policy looks at (`wanted`).
            at: When it was taken [ns].
            now: Steady clock [ns].
        """
        session = self.session
        if session is None or self.state is not State.RUNNING:
            return
        self._blind = ""
        seq = session.note(Sent(observation.stamp_ns, observation.step, at, now))
        head = {
            "session": session.number,
            "seq": seq,
            "stamp_ns": observation.stamp_ns,
            "episode": self.episode,
            "step": observation.step,
            "instruction": self._settings.instruction,
        }
        arrays = {key: observation.arrays[key] for key in session.spec.observation}
        self.outbox.append((session.peer, wire.encode(Message("OBS", head, arrays))))

    def observe_nothing(self, why: str) -> None:
        """There is no observation at this grid time, and why."""
        self._blind = why

    @property
    def wanted(self) -> tuple[str, ...]:
        """Keys of what the connected policy looks at."""
        return tuple(self.session.spec.observation) if self.session is not None else ()

    @property
    def unanswered(self) -> bool:
        """The newest observation is still to be answered."""
        session = self.session
        return (
            self.state is State.RUNNING and session is not None and session.answered < session.seq
        )

    def execute(self, number: int, at: int, past: int | None = None) -> dict[str, Target]:
        """The step that brings the arms to where they shall be at a grid time.

        Args:
            number: Of the grid time.
            at: When it is sent, or begins to be played [ns].
            past: What comes from now on of the steps up to this one is late; default: ``number``.

        Returns:
            What to send, by arm; empty: nothing.
        """
        self._at = at
        if self.state is not State.RUNNING or self.session is None:
            self._queue.take(number, past)
            return {}
        self._drop_stale(at)
        step = self._queue.take(number, past)
        if step is None:
            self.counters.empty += 1
            self._empty.lasts(at)
            if self._empty.exceeded(at):
                limit = self._settings.empty / SECOND
                why = f"the policy has sent no action for more than {limit:g} s"
                if self._blind:
                    why = f"nothing could be observed for more than {limit:g} s: {self._blind}"
                self._stop(State.PAUSED, why)
            return {}
        self._empty.over()
        return self._judge(step, at)

    def coming(self, number: int) -> dict[str, Target] | None:
        """What the policy wants at a grid time that is still to come, if that is known."""
        step = self._queue.peek(number)
        return None if step is None else self._targets(step.row)

    def _drop_stale(self, at: int) -> None:
        stale = self._queue.drop_older(at - self._settings.max_obs_age)
        self.counters.stale += stale
        self._told.stale += stale

    def _targets(self, row: Array) -> dict[str, Target]:
        parts = row.reshape(-1, len(ACTION))
        return {
            name: Target.of(part) for name, part in zip(self._settings.arms, parts, strict=True)
        }

    def _judge(self, step: Step, at: int) -> dict[str, Target]:
        assert self.session is not None
        passed, broken = self._safety.judge(self._targets(step.row), self._views, at)
        if not passed:
            self._reject(step.number, broken[0].rule, broken[0].text, step.seq, step.row)
            if self.session is not None:
                self._acknowledge(self.session, step.seq)
            return {}
        self._in_a_row = 0
        self.counters.accepted += 1
        self.counters.obs_age.add(at - step.seen)
        self._told.accepted += 1
        self._told.clipped += bool(broken)
        self.counters.clipped += bool(broken)
        values = np.concatenate([target.row for target in passed.values()])
        self.judged.append(
            Judged(
                session=self.session.number,
                seq=step.seq,
                step=step.number,
                obs_age=at - step.seen,
                values=values,
                passed=True,
                rule=",".join(each.rule for each in broken),
                text="; ".join(each.text for each in broken),
            )
        )
        return passed

    def _reject(self, step: int, rule: str, text: str, seq: int, values: Array) -> None:
        """A rule refuses; the third time in a row the arms are paused."""
        assert self.session is not None
        sent = self.session.sent.get(seq)
        age = self._at - sent.seen if sent is not None else 0
        number = self.session.number
        self.counters.rejected[rule] += 1
        self.judged.append(Judged(number, seq, step, age, values, False, rule, text))
        self._told.rejected.append({"step": step, "rule": rule, "text": text[:1024]})
        self._in_a_row += 1
        if self._in_a_row >= REJECTS and self.state is State.RUNNING:
            self._stop(State.PAUSED, f"{REJECTS} rejected steps in a row; the last: {text}")

    # --- states -----------------------------------------------------------------------------------

    def _run(self) -> None:
        """The arms are here; what was seen before that is answered too late."""
        self.state, self.reason = State.RUNNING, ""
        if self.session is not None:
            self.session.answered = self.session.seq
        self._queue.flush()
        self._safety.forget()
        self._in_a_row = 0
        self._empty.since = self._at
        if self._open:
            self._say_episode("resumed", None, "")
        else:
            self._open = True
            self.episode += 1
            self._say_episode("begin", None, "")

    def _stop(self, state: State, reason: str) -> None:
        """Let go: nothing that was queued is executed, what is held is paused."""
        self._queue.flush()
        self._safety.forget()
        self._empty.over()
        self._handover.leave(self._views)
        self.state, self.reason = state, reason
        if self.session is not None and self._told.rejected:
            self._acknowledge(self.session, self.session.answered)
        if self._open:
            self._say_episode("paused", None, reason)

    def _lose(self, reason: str) -> None:
        """The policy is gone."""
        if self.state in (State.WAKING, State.RUNNING):
            self._stop(State.PAUSED, reason)
        self._forget(reason)

    def _forget(self, reason: str) -> None:
        self.session, self._start = None, False
        self.state, self.reason = State.IDLE, f"{reason}; no policy is connected"

    # --- the wire ---------------------------------------------------------------------------------

    def receive(self, peer: bytes, parts: Sequence[Any], now: int) -> None:
        """A message has come; whatever is in it, this returns.

        Args:
            peer: Identity of the connection.
            parts: Its frames without the identity.
            now: Steady clock [ns].
        """
        self.counters.messages += 1
        if not self._flow.admits(peer, now):
            self.counters.flooded += 1
            return
        try:
            message = wire.decode(parts)
        except WireError as error:
            self._malformed(peer, error)
            return
        except Exception as error:  # whatever the codec may have overlooked ends no server
            self._malformed(peer, WireError("other", f"{type(error).__name__} {error}"[:300]))
            return
        if message.kind == "HELLO":
            self._hello(peer, message.head, now)
            return
        session = self.session
        if session is None or peer != session.peer or message.head.get("session") != session.number:
            self.counters.strangers += 1
            self._error(peer, "session", "there is no such session here: say HELLO")
            return
        session.heard(now)
        if message.kind == "PING":
            self._send(peer, "PONG", session=session.number, n=message.head["n"])
        elif message.kind == "ACT":
            self._act(session, message, now)
        elif message.kind == "RESET":
            self._reset(session)
        elif message.kind == "BYE":
            self._lose(f"the policy said goodbye: {message.head['reason'] or 'no reason given'}")
        else:
            self._error(peer, "kind", f"{message.kind} is a message of the server's side")

    def _malformed(self, peer: bytes, error: WireError) -> None:
        """No message. The policy in session is told; a stranger gets no answer to noise."""
        self.counters.malformed[error.code] += 1
        session = self.session
        if session is None or peer != session.peer:
            return
        if error.code == "finite" and self.state is State.RUNNING:
            self._reject(0, "not_finite", str(error), 0, np.zeros(0))
            if self.session is not None:
                self._acknowledge(self.session, self.session.answered)
        else:
            self._error(peer, error.code, str(error))

    def _hello(self, peer: bytes, head: dict[str, Any], now: int) -> None:
        session = self.session
        if session is not None and session.peer == peer:
            session.heard(now)
            self._welcome(session)  # its HELLO crossed the answer
            return
        if session is not None and not session.silence.exceeded(now):
            self._error(
                peer,
                "busy",
                f"{session.policy or session.client} is connected; one policy at a time",
            )
            return
        if session is not None:
            self._lose("the policy fell silent")
        if self._spec is None:
            self._early, self.waiting = (peer, head), True
            return
        if refused := refusal(head, VERSIONS, self._spec):
            self._error(peer, *refused)
            return
        made = Session(
            number=self._draw(),
            peer=peer,
            client=head["client"],
            policy=head["policy"],
            spec=spec_for(head, self._spec),
            silence=Patience(self._settings.silence, now),
        )
        self.session, self.waiting = made, True
        self.counters.sessions += 1
        self._told = _Told()
        if self.state is State.IDLE:
            self.state, self.reason = State.READY, "not enabled"
        self._start = self._settings.autostart
        self._welcome(made)

    def _welcome(self, session: Session) -> None:
        self._send(
            session.peer,
            "WELCOME",
            version=wire.VERSION,
            session=session.number,
            spec=session.spec.to_map(),
            max_obs_age_s=self._settings.max_obs_age / SECOND,
            ping_s=PING / SECOND,
            silence_s=self._settings.silence / SECOND,
        )

    def _reset(self, session: Session) -> None:
        """A new episode is begun by who runs the system; one that has not moved is as good."""
        if self.state is State.RUNNING and not session.acted:
            return
        self._error(
            session.peer,
            "reset",
            "episodes are begun on the server's side: ./surg run begins the next one by itself, "
            "else publish true on /policy/enable when the scene is ready",
        )

    def _act(self, session: Session, message: Message, now: int) -> None:
        head, rows = message.head, message.arrays["chunk"]
        seq, first = head["seq"], head["step0"]
        sent = session.sent.get(seq)
        if sent is None or sent.stamp_ns != head["stamp_ns"]:
            text = f"observation {seq} of stamp {head['stamp_ns']} was not sent, or long ago"
            self._reject(first, "observation", text, 0, np.zeros(0))
        elif seq <= session.answered or self.state is not State.RUNNING:
            self._count_stale(len(rows))
        else:
            session.answered, session.acted = seq, True
            self.counters.round_trip.add(now - sent.sent)
            if self._at - sent.seen > self._settings.max_obs_age:
                self._count_stale(len(rows))
            elif len(rows):
                self._splice(session, first, rows, seq, sent)
        if self.session is not None:
            self._acknowledge(self.session, seq)

    def _splice(self, session: Session, first: int, rows: Any, seq: int, sent: Sent) -> None:
        if wrong := session.spec.check_chunk(rows):
            self._reject(first, "shape", "; ".join(wrong), seq, np.zeros(0))
            return
        late = self._queue.splice(first, rows, seq, sent.seen)
        self.counters.late += late
        self._told.late += late

    def _count_stale(self, rows: int) -> None:
        self.counters.stale += rows
        self._told.stale += rows

    def _acknowledge(self, session: Session, seq: int) -> None:
        told, self._told = self._told, _Told()
        self._send(
            session.peer,
            "ACK",
            session=session.number,
            seq=seq,
            accepted=told.accepted,
            clipped=told.clipped,
            late=told.late,
            stale=told.stale,
            rejected=told.rejected,
            queue=len(self._queue),
        )

    def _say_episode(self, event: str, success: bool | None, reason: str) -> None:
        if self.session is None:
            return
        self._send(
            self.session.peer,
            "EPISODE",
            session=self.session.number,
            episode=self.episode,
            event=event,
            instruction=self._settings.instruction,
            success=success,
            reason=reason[:1024],
        )

    def _error(self, peer: bytes, code: str, text: str) -> None:
        self._send(peer, "ERR", code=code, text=text)

    def _send(self, peer: bytes, kind: str, **head: Any) -> None:
        self.outbox.append((peer, wire.encode(Message(kind, head))))

    # --- for people -------------------------------------------------------------------------------

    def report(self) -> dict[str, object]:
        """What the status topic says."""
        session = self.session
        return {
            "state": self.state.value,
            "reason": self.reason,
            "waiting": self.waiting,
            "session": session.number if session else None,
            "client": session.client if session else "",
            "policy": session.policy if session else "",
            "episode": self.episode,
            "queue": len(self._queue),
            "period_ms": 1e3 * PERIOD / SECOND,
            **self.counters.report(),
        }
