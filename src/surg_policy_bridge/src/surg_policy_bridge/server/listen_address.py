"""Where a server may listen: an address that leaves this machine needs keys (F19)."""

from __future__ import annotations

import ipaddress
from urllib.parse import urlsplit

LOOPBACK_NAMES = ("localhost",)


class BindError(ValueError):
    """An address at which no server is started: what is wrong, and what would do."""


def check(address: str, keyed: bool) -> str:
    """An address that may be bound.

    Args:
        address: ``tcp://HOST:PORT`` or ``ipc://PATH``.
        keyed: There are CURVE keys.

    Returns:
        The address.

    Raises:
        BindError: It may not be bound.
    """
    examples = "tcp://127.0.0.1:5555 or ipc:///tmp/policy"
    try:
        parts = urlsplit(address)
        host, port = parts.hostname or "", parts.port
    except ValueError as error:
        raise BindError(f"address {address!r}: {error}; such as {examples}") from None
    if parts.scheme == "ipc" and address.removeprefix("ipc://").startswith("/"):
        return address
    if parts.scheme != "tcp" or not host or port is None or parts.path:
        raise BindError(f"address {address!r}: such as {examples}")
    if not (keyed or _is_loopback(host)):
        raise BindError(
            f"address {address!r} can be reached from other machines, and anybody there could move "
            "the arms: make keys with ./surg keys and name their folder, or bind tcp://127.0.0.1:"
            f"{port}"
        )
    return address


def _is_loopback(host: str) -> bool:
    if host in LOOPBACK_NAMES:
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:  # a name or an interface: it may be anything
        return False
