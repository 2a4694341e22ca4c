"""What the web server and its sockets need of the running system."""

from __future__ import annotations

from typing import Protocol

from surg_console.session.console_orders import Order
from surg_console.session.episode_list import Entry
from surg_console.session.system_state import Robot


class RunningSystem(Protocol):
    """The robot's side; no call may block."""

    def robot(self) -> Robot:
        """Its present state."""

    def reset_peaks(self) -> None:
        """The pages have got the state; peak values start again."""

    def publish_orders(self, orders: list[Order]) -> None:
        """Send orders."""

    def keep_alive(self) -> None:
        """Called all the time: re-publishes what is held down, so that silence is noticed."""

    def entries(self) -> list[Entry]:
        """The recorded episodes; may read files, so it is called in a thread."""

    def judge(self, word: str) -> str:
        """A person's judgement on the last recording, of `JUDGEMENTS`; returns why it failed.

        Writes files, so it is called in a thread.
        """

    def watch(self, what: str, wanted: bool) -> None:
        """Begin to collect `marks`, `plan`, `scene` or `feel`, or stop."""

    def overlay(self, what: str) -> str:
        """The newest of them as JSON; empty: there is none."""
