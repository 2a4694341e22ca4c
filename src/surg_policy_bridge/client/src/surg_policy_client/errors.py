"""What can go wrong between a policy and its server: each error says what to do."""

from __future__ import annotations


class PolicyClientError(Exception):
    """Base of all errors of this library."""


class NoServer(PolicyClientError):
    """Nobody answered at the address in the time given."""


class VersionMismatch(PolicyClientError):
    """Client and server share no version of the protocol."""


class SpecMismatch(PolicyClientError):
    """What the policy wants and what the server has differ; the text names both."""


class Refused(PolicyClientError):
    """The server refused a request or a message.

    Attributes:
        code: The server's word for it.
    """

    def __init__(self, code: str, text: str) -> None:
        super().__init__(text)
        self.code = code


class BadKeys(PolicyClientError):
    """Keys that are missing, unreadable, open to others or of the wrong kind."""


class BadAction(PolicyClientError):
    """What a policy returned is no chunk of actions; nothing was sent."""
