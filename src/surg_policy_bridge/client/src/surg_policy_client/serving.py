"""`serve`: answers the observations of a model server with the actions of a policy."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any, Callable, Sequence, Union

from surg_policy_client.attention import to_wire
from surg_policy_client.errors import Refused
from surg_policy_client.keys import ClientKeys, Folder
from surg_policy_client.link import Link
from surg_policy_client.observation import Observation, as_message
from surg_policy_client.spec import Spec
from surg_policy_client.wire import Message

ADDRESS = "tcp://127.0.0.1:5555"
Wants = Union[Spec, Sequence[str], None]
_REMIND_S = 5.0
"""Longest silence while nobody answers: a server that starts with its policy takes seconds."""


@dataclass
class Served:
    """Statistics of `serve`.

    Attributes:
        sessions: Number of sessions; more than one after a lost connection.
        episodes: Episodes that ended.
        successes: Of them, those with success.
        observations: Observations answered.
        skipped: Observations replaced by a newer one while the policy was busy.
        accepted: Rows accepted, counted by the server as are the next four.
        clipped: Rows that a limit has changed.
        late: Rows whose time had passed.
        stale: Rows whose observation was too old.
        rejected: Rows rejected.
    """

    sessions: int = 0
    episodes: int = 0
    successes: int = 0
    observations: int = 0
    skipped: int = 0
    accepted: int = 0
    clipped: int = 0
    late: int = 0
    stale: int = 0
    rejected: int = 0


def wanted(wants: Wants) -> Spec | None:
    """Observations as a spec; keys alone match any shape and type."""
    if wants is None or isinstance(wants, Spec):
        return wants
    return Spec.of_keys([wants] if isinstance(wants, str) else list(wants))


def serve(
    policy: Any,
    address: str = ADDRESS,
    *,
    wants: Wants = None,
    keys: ClientKeys | Folder | None = None,
    name: str | None = None,
    seed: int | None = None,
    episodes: int | None = None,
    timeout_s: float | None = None,
    say: Callable[[str], None] = print,
) -> Served:
    """Connect a policy to a model server and answer its observations until Ctrl-C.

    Lost connections are restored. The policy is `reset` whenever it enters an episode, also when it
    returns to one. Rejected steps are reported once per rule and episode.

    Args:
        policy: Has ``act(observation)`` and optionally ``reset(instruction, seed)``,
            ``acknowledged(fields_of_ACK)``, ``wants``, and ``seen()``, the `Attention` of the
            observation, for people who watch; or is the function ``act`` itself. It returns a
            `Chunk`, rows [K, A], one row [A], or None (earlier rows stay valid).
        address: Of the server.
        wants: Observations that the policy needs, as keys or as a `Spec`; default:
            ``policy.wants``, else everything served. Only these are sent.
        keys: Folder of `./surg policy keys`, if the server was started with keys.
        name: Of the policy, for the server's log.
        seed: ``reset`` gets this plus the number of the episode; None: no seed.
        episodes: Number of episodes; None: no end.
        timeout_s: Longest wait for a server [s]; None: no limit.
        say: Gets lines of text for the user.

    Returns:
        Statistics.

    Raises:
        PolicyClientError: Server and policy do not match, no server answers in time, or the policy
            returned no valid action. The arm holds from then on.
    """
    spec = wanted(getattr(policy, "wants", None) if wants is None else wants)
    label = name or getattr(policy, "name", None) or getattr(policy, "__name__", None)
    link = Link(address, wants=spec, policy=label or type(policy).__name__, keys=keys)
    serving = _Serving(policy, link, seed, say)
    reason = "the policy ended"
    try:
        if timeout_s is not None and not link.wait_for_welcome(timeout_s):
            raise link.no_server(timeout_s)
        serving.until(episodes)
    except KeyboardInterrupt:
        reason = "stopped by the user"
    except Exception as error:
        reason = f"the policy failed: {type(error).__name__}: {error}"
        raise
    finally:
        link.close(reason)
        serving.served.skipped = link.skipped
    return serving.served


class _Serving:
    """The loop of `serve`."""

    def __init__(
        self, policy: Any, link: Link, seed: int | None, say: Callable[[str], None]
    ) -> None:
        self.served = Served()
        self._policy, self._link, self._seed, self._say = policy, link, seed, say
        self._act = policy.act if hasattr(policy, "act") else policy
        self._spec = Spec()
        self._entered: tuple[int, int] | None = None
        self._reported: set[str] = set()
        self._blind = False

    def until(self, episodes: int | None) -> None:
        """Answer until so many episodes have ended."""
        waiting_since, reminded = time.monotonic(), 0.0
        while episodes is None or self.served.episodes < episodes:
            message = self._link.next(0.5)
            now = time.monotonic()
            if message is not None:
                self._take(message)
                waiting_since = now
            elif self._link.session is None and now - max(waiting_since, reminded) >= _REMIND_S:
                reminded = now
                hint = self._link.hint()
                self._say(f"waiting for a model server at {self._link.address}: {hint}")

    def _take(self, message: Message) -> None:
        head = message.head
        if message.kind == "OBS":
            self._answer(Observation.of(message, self._spec))
        elif message.kind == "WELCOME":
            self._spec = Spec.from_map(head["spec"])
            self.served.sessions += 1
            self._say(f"connected to {self._link.address}: {described(self._spec)}")
        elif message.kind == "EPISODE":
            self._episode(head)
        elif message.kind == "ACK":
            self._acknowledged(head)
        elif message.kind == "ERR":
            raise Refused(head["code"], f"the server at {self._link.address}: {head['text']}")
        elif message.kind == "BYE":
            self._say(f"the server has ended the session: {head['reason']}")

    def _answer(self, observation: Observation) -> None:
        self._enter(observation.session, observation.episode, observation.instruction)
        message = as_message(self._act(observation), observation)
        self._link.send(self._with_seen(message))
        self.served.observations += 1

    def _with_seen(self, message: Message) -> Message:
        """An ACT with what the policy sees; a mistake in that is said once and does no harm."""
        if self._blind or not hasattr(self._policy, "seen") or not self._link.tells:
            return message
        try:
            seen = self._policy.seen()
            if seen is not None:
                to_wire(seen)
            return replace(message, seen=seen)
        except Exception as error:  # a mistake in a picture for people must not stop an arm
            self._blind = True
            self._say(f"what the policy sees is not shown: {type(error).__name__}: {error}")
            return message

    def _enter(self, session: int, episode: int, instruction: str) -> None:
        """Reset the policy when it enters an episode."""
        if self._entered == (session, episode):
            return
        self._entered = (session, episode)
        self._reported.clear()
        if hasattr(self._policy, "reset"):
            seed = None if self._seed is None else self._seed + episode
            self._policy.reset(instruction, seed)

    def _episode(self, head: dict[str, Any]) -> None:
        event, number = head["event"], head["episode"]
        if event == "begin":
            self._enter(head["session"], number, head["instruction"])
            self._say(f"episode {number}: {head['instruction']}")
            return
        if event == "end":
            self.served.episodes += 1
            self.served.successes += head["success"] is True
            verdict = {True: "success", False: "failure", None: "ended"}[head["success"]]
            self._say(f"episode {number}: {verdict}: {head['reason']}")
            return
        self._say(f"episode {number}: {event}: {head['reason']}")

    def _acknowledged(self, head: dict[str, Any]) -> None:
        for count in ("accepted", "clipped", "late", "stale"):
            setattr(self.served, count, getattr(self.served, count) + head[count])
        self.served.rejected += len(head["rejected"])
        for rejection in head["rejected"]:
            if rejection["rule"] not in self._reported:
                self._reported.add(rejection["rule"])
                self._say(f"the server rejected step {rejection['step']}: {rejection['text']}")
        if hasattr(self._policy, "acknowledged"):
            self._policy.acknowledged(head)


def described(spec: Spec) -> str:
    """A served spec in one line."""
    actions = spec.action.names if spec.action is not None else ()
    observations = ", ".join(
        f"{key} {'x'.join(map(str, feature.shape or ()))}"
        + (" (privileged)" if feature.privileged else "")
        for key, feature in spec.observation.items()
    )
    rate = 1.0 / spec.period_s if spec.period_s else 0.0
    return f"task {spec.task}, {rate:g} Hz; {observations} -> {', '.join(actions)}"
