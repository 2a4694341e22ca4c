"""Lock-step protocol: when to execute a tick, when to repeat a state, when to abort.

Pure: times are arguments (seconds of any steady clock). One ``Lockstep`` follows one run:

* tick k is executed once every arm has answered k on both links, every participant has sent Ready
  for k (the controller waits for it too, but its ``done`` must be known here), all commands that it
  announced to the assistant's instrument have arrived, and every observer is within its window;
* after ``republish`` seconds of silence state k is published again (receivers answer it once);
* after ``abort`` seconds of silence the run is aborted, naming the missing nodes;
* once every declared participant has sent ``done``, tick k is the last one executed.
"""

from __future__ import annotations

import enum
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

LINKS = ("robot", "tool")
"""The links of an arm; each must be answered in every tick."""

OBSERVER_WINDOWS = {"recorder": 500, "endoscope": 1000}
"""Ticks that each observer may lag behind; queues are unbounded, so nothing is lost."""


class Action(enum.Enum):
    """Result of ``poll``."""

    WAIT = enum.auto()
    REPUBLISH = enum.auto()
    ABORT = enum.auto()


@dataclass
class _Participant:
    tick: int = 0
    last: int | None = None  # first tick said to be the last; a participant may run ahead of it
    sent: int = 0  # announced to this side
    received: int = 0


class Lockstep:
    """The state of one lock-step run.

    Args:
        arms: Names of the arms, each answered by a controller.
        participants: Declared commanders.
        observers: Observers by name with the window of each [ticks].
        republish: Silence after which a state is published again [s].
        abort: Silence after which the run is aborted [s].
        strict: Wait for every participant from tick 1 on. Requires latched Ready messages.
    """

    def __init__(
        self,
        arms: Iterable[str],
        participants: Iterable[str] = (),
        observers: Mapping[str, int] | None = None,
        republish: float = 2.0,
        abort: float = 10.0,
        strict: bool = False,
    ) -> None:
        self._answered = {(arm, link): 0 for arm in arms for link in LINKS}
        self._participants = {name: _Participant() for name in participants}
        self._windows = dict(observers or {})
        self._observers = dict.fromkeys(self._windows, 0)
        self._republish, self._abort, self._strict = republish, abort, strict
        self._waiting_since = self._asked_at = 0.0
        self.tick = 0
        """Tick of the published state; 0 before ``publish``."""

    def publish(self, tick: int, now: float) -> None:
        """State ``tick`` has been published for the first time at ``now``."""
        self.tick = tick
        self._waiting_since = self._asked_at = now

    def answer(self, arm: str, link: str, tick: int) -> bool:
        """A link command stamped with ``tick`` has arrived; whether it must be used.

        Only the first answer to the present state: not late, repeated and early ones.
        """
        key = (arm, link)
        if tick != self.tick or self._answered[key] == tick:
            return False
        self._answered[key] = tick
        return True

    def declared(self, name: str) -> bool:
        """Whether this is a declared participant."""
        return name in self._participants

    def received(self, name: str) -> None:
        """Count a command to the assistant; undeclared senders are ignored."""
        if name in self._participants:
            self._participants[name].received += 1

    def ready(self, name: str, tick: int, done: bool, sent: int = 0) -> None:
        """Take a ``Ready``; undeclared senders are ignored.

        The sender is done with this tick, or with the run; ``sent`` is the running total of its
        commands to the assistant.
        """
        if name in self._participants:
            participant = self._participants[name]
            participant.tick = max(participant.tick, tick)
            participant.sent = max(participant.sent, sent)
            if done and participant.last is None:
                participant.last = tick
        elif name in self._observers:
            self._observers[name] = max(self._observers[name], tick)

    def may_step(self) -> bool:
        """True when the present tick may be executed."""
        return (
            self.tick > 0
            and all(tick == self.tick for tick in self._answered.values())
            and all(self._is_ready(p) for p in self._participants.values())
            and not self._late_observers()
        )

    def _is_ready(self, participant: _Participant) -> bool:
        """Whether a participant's Ready for the present tick has arrived or cannot arrive.

        A Ready sent before the connection was made is lost, so a participant that was never heard
        is not waited for here; the controller, which needs its commands, waits for it.
        """
        done = participant.last is not None
        here = participant.received >= participant.sent
        unheard = participant.tick == 0 and not self._strict
        return here and (done or unheard or participant.tick >= self.tick)

    def finished(self) -> bool:
        """True when the answer to the present tick is the last one to execute."""
        return bool(self._participants) and all(
            p.last is not None and p.last <= self.tick for p in self._participants.values()
        )

    def _late_observers(self) -> list[str]:
        return [
            name for name, tick in self._observers.items() if self.tick - tick > self._windows[name]
        ]

    def missing(self) -> list[str]:
        """One sentence per node that the present tick waits for."""
        sentences = [
            f"participant '{name}' has not sent Ready for tick {self.tick} (last: {p.tick})"
            for name, p in self._participants.items()
            if p.tick < self.tick and p.last is None
        ]
        sentences += [
            f"participant '{name}' has sent the assistant {p.sent} commands of which {p.received} "
            f"arrived"
            for name, p in self._participants.items()
            if p.received < p.sent
        ]
        topics = {"robot": "a robot command", "tool": "tool/servo_jp"}
        sentences += [
            f"the controller of {arm} has not answered tick {self.tick} with {topics[link]} "
            f"(last: {tick})"
            for (arm, link), tick in self._answered.items()
            if tick < self.tick
        ]
        sentences += [
            f"observer '{name}' is at tick {self._observers[name]}, more than "
            f"{self._windows[name]} behind tick {self.tick}"
            for name in self._late_observers()
        ]
        return sentences

    def poll(self, now: float) -> Action:
        """Check the time; call it a few times a second while waiting.

        REPUBLISH is returned once per ``republish`` seconds.
        """
        if self.tick == 0:
            return Action.WAIT
        if now - self._waiting_since >= self._abort:
            return Action.ABORT
        if now - self._asked_at >= self._republish:
            self._asked_at = now
            return Action.REPUBLISH
        return Action.WAIT
