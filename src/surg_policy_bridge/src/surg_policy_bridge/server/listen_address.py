"""Checks the listen address: one reachable from other machines needs keys (F19)."""

from __future__ import annotations

import ipaddress
from urllib.parse import urlsplit


class BindError(ValueError):
    """An address that cannot be used: what is wrong and what is allowed."""


def check(address: str, keyed: bool) -> str:
    """Check an address, ``tcp://HOST:PORT`` or ``ipc://PATH``; returns it.

    Raises:
        BindError: It must not be bound.
    """
    examples = "tcp://127.0.0.1:5555 or ipc:///tmp/policy"
    try:
        parts = urlsplit(address)
        host, port = parts.hostname or "", parts.port
    except ValueError as error:
        raise BindError(
            f"address {address!r}: {error}; use an address such as {examples}"
        ) from None
    if parts.scheme == "ipc" and address.removeprefix("ipc://").startswith("/"):
        return address
    if parts.scheme != "tcp" or not host or port is None or parts.path:
        raise BindError(f"address {address!r}: use an address such as {examples}")
    if not (keyed or _is_loopback(host)):
        raise BindError(
            f"address {address!r} is reachable from other machines, and anybody there could move "
            "the arms; make keys with ./surg policy keys and give their folder, or bind "
            f"tcp://127.0.0.1:{port}"
        )
    return address


def _is_loopback(host: str) -> bool:
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:  # a host name or an interface
        return False
