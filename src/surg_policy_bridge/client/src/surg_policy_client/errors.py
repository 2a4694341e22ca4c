"""Errors of the client; each message states what to do."""

from __future__ import annotations


class PolicyClientError(Exception):
    """Base of all errors of this library."""


class NoServer(PolicyClientError):
    """No server has answered within the timeout."""


class BadAddress(PolicyClientError, ValueError):
    """An address that is none."""


class VersionMismatch(PolicyClientError):
    """Client and server have no protocol version in common."""


class SpecMismatch(PolicyClientError):
    """The policy needs what the server does not serve; the message names both."""


class Refused(PolicyClientError):
    """The server refused a request or a message.

    Attributes:
        code: Reason code of the server.
    """

    def __init__(self, code: str, text: str) -> None:
        super().__init__(text)
        self.code = code


class BadKeys(PolicyClientError):
    """Keys are missing, unreadable, of the wrong kind, or readable by others."""


class BadAction(PolicyClientError):
    """A policy returned no valid chunk of actions; nothing was sent."""
