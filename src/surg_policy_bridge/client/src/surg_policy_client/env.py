"""The robot as an environment with `reset` and `step`, over the wire; without gymnasium."""

from __future__ import annotations

import time
from typing import Any

from surg_policy_client.errors import NoServer, Refused
from surg_policy_client.keys import ClientKeys, Folder
from surg_policy_client.link import Link
from surg_policy_client.observation import Observation, as_message
from surg_policy_client.serving import ADDRESS, Wants, wanted
from surg_policy_client.spec import Spec
from surg_policy_client.wire import Message

BROKEN_OFF = "the server began another session or episode before the end of this one"


class RemoteEnv:
    """A task on a model server, with the interface of Gymnasium.

    In lock-step time waits for `step`. In real time a slow caller gets the newest observation, and
    `info["skipped"]` counts those it missed. There is no reward on the wire; ``info["success"]`` is
    the task's verdict at the end of the episode.

    Args:
        address: Of the server.
        wants: Observations, as keys or as a `Spec`; None: everything served.
        keys: Folder of `./surg policy keys`, if the server was started with keys.
        timeout_s: Longest wait for the server, an episode or an observation [s].
    """

    def __init__(
        self,
        address: str = ADDRESS,
        *,
        wants: Wants = None,
        keys: ClientKeys | Folder | None = None,
        timeout_s: float = 30.0,
    ) -> None:
        self._timeout = timeout_s
        self._link = Link(address, wants=wanted(wants), policy="RemoteEnv", keys=keys)
        self.spec = Spec()
        self._last: Observation | None = None
        self._over: Message | None = None
        self._acted: tuple[int, int] | None = None
        self._broken_off = False
        self._acks: dict[str, Any] = {}
        self._note = ""
        try:
            if not self._link.wait_for_welcome(timeout_s):
                raise self._link.no_server(timeout_s)
            if (welcome := self._link.next(timeout_s)) is not None and welcome.kind == "WELCOME":
                self.spec = Spec.from_map(welcome.head["spec"])
        except BaseException:
            self._link.close()
            raise

    def reset(self) -> tuple[Observation, dict[str, Any]]:
        """First observation of an episode, and info.

        An episode without actions so far is used; otherwise the server is asked for a new one. If
        the server begins its episodes itself, as under `./surg run`, this waits for the next one.

        Raises:
            Refused: The present episode is not over and the server does not end it; it can go on.
            NoServer: No episode begins in time.
        """
        before = self._last, self._over, self._acted
        going_on = self._acted if self._over is None else None
        if self._acted is not None:
            self._request_episode()
        try:
            observation = self._last or self._wait(self._timeout, going_on)
        except Refused:
            self._last, self._over, self._acted = before
            raise
        if observation is None:
            raise self._timeout_error("began no episode")
        self._broken_off = False
        return observation, self._info()

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Send an action and wait for the next observation.

        Args:
            action: One row [A], rows [K, A] or a `Chunk`, from the next grid time on.

        Returns:
            Observation, reward (always 0.0), terminated, truncated, info. Truncated means that the
            server began another session or episode before the end of this one. The observation is
            then the last of this one, and `reset` returns the first of the other.
        """
        self.send(action)
        return self.observe()

    def send(self, action: Any) -> None:
        """Answer the newest observation, without waiting for the next one."""
        observation = self._present()
        self._link.send(as_message(action, observation))
        self._acted = observation.session, observation.episode

    def observe(self) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Wait for the next observation; returns what `step` does."""
        before, self._last = self._present(), None
        observation = self._wait(self._timeout)
        if observation is None and self._over is None:
            raise self._timeout_error("sent no observation")
        if observation is not None and (
            (observation.session, observation.episode) != (before.session, before.episode)
        ):
            self._acted, self._broken_off = None, True  # without actions: `reset` uses it
            return before, 0.0, False, True, {**self._info(), "reason": BROKEN_OFF}
        self._last = observation or before
        return self._last, 0.0, self._over is not None, False, self._info()

    def _present(self) -> Observation:
        """The newest observation of an episode that is not over."""
        if self._last is None or self._over is not None or self._broken_off:
            raise RuntimeError("there is no episode; call reset() first")
        return self._last

    def close(self) -> None:
        """Close the connection."""
        self._link.close("the environment was closed")

    def __enter__(self) -> RemoteEnv:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _request_episode(self) -> None:
        session = self._link.session
        if session is None and self._link.wait_for_welcome(self._timeout):
            session = self._link.session
        if session is None:
            raise self._link.no_server(self._timeout)
        self._last, self._over, self._acted = None, None, None
        self._link.send(Message("RESET", {"session": session}))

    def _wait(self, timeout_s: float, former: tuple[int, int] | None = None) -> Observation | None:
        """The next observation of another (session, episode) than ``former``; None: the end."""
        until = time.monotonic() + timeout_s
        while (left := until - time.monotonic()) > 0:
            message = self._link.next(left)
            if message is None:
                continue
            if message.kind == "WELCOME":
                self.spec = Spec.from_map(message.head["spec"])
            elif message.kind == "OBS":
                observation = Observation.of(message, self.spec)
                if (observation.session, observation.episode) != former:
                    self._last = observation
                    return observation
            elif message.kind == "ACK":
                self._acks = message.head
            elif message.kind == "ERR":
                code, text = message.head["code"], message.head["text"]
                if code != "reset" or (former is not None and former[0] == self._link.session):
                    raise Refused(code, text)
                self._note = f"It reports: {text}. "  # the next episode may still begin
            elif message.kind == "EPISODE":
                event, reason = message.head["event"], message.head["reason"]
                self._note = f"the episode was {event}: {reason}. " if event == "paused" else ""
                if event == "end" and self._acted is not None:
                    self._over = message
                    return None
        return None

    def _timeout_error(self, what: str) -> NoServer:
        return NoServer(
            f"the server at {self._link.address} {what} within {self._timeout:g} s. {self._note}"
            "Check that the policy is enabled there and that nobody else is at the controls."
        )

    def _info(self) -> dict[str, Any]:
        over = self._over.head if self._over is not None else {}
        return {
            "success": over.get("success"),
            "reason": over.get("reason", ""),
            "acknowledged": self._acks,
            "skipped": self._link.skipped,
        }
