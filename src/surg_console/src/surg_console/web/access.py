"""Access rules of the console: listen address, accepted Host and Origin headers, token.

On loopback every user of this machine may open the page. Elsewhere it takes TLS and a token. Host
and Origin checks keep foreign web pages in the operator's browser from reaching the console (DNS
rebinding, cross-site sockets).
"""

from __future__ import annotations

import hmac
import ipaddress
from dataclasses import dataclass
from pathlib import Path

MIN_TOKEN = 16
LOOPBACK_NAMES = ("localhost", "127.0.0.1", "[::1]")


class AccessError(ValueError):
    """Unsafe or inconsistent options: what is wrong and what is needed."""


@dataclass(frozen=True)
class Access:
    """The rules of one console."""

    bind: str
    port: int
    name: str  # host name or address that people open
    hosts: frozenset[str]  # accepted values of the header Host
    token: str = ""  # secret that pages must send first; may be empty on loopback
    # TLS certificate and key; None: no TLS, on loopback only
    certificate: tuple[Path, Path] | None = None

    @property
    def scheme(self) -> str:
        """Http or https."""
        return "https" if self.certificate else "http"

    @property
    def url(self) -> str:
        """Address of the page without the token; safe to log."""
        return f"{self.scheme}://{self.name}:{self.port}/"

    @property
    def fragment(self) -> str:
        """To be appended to `url`: browsers do not send what follows the #."""
        return f"#token={self.token}" if self.token else ""

    def host_allowed(self, host: str | None) -> bool:
        """Whether the header Host names this console."""
        return host is not None and host.lower() in self.hosts

    def origin_allowed(self, origin: str | None) -> bool:
        """Whether a socket's header Origin names a page of this console."""
        if origin is None:
            return False
        scheme, _, host = origin.lower().partition("://")
        return scheme == self.scheme and host in self.hosts

    def token_allowed(self, token: str) -> bool:
        """Whether the token is right; compares in constant time."""
        given = token.encode("utf-8", "surrogatepass")  # JSON allows lone surrogates
        return hmac.compare_digest(given, self.token.encode())


def is_loopback(bind: str) -> bool:
    """Whether an address is reachable from this machine only."""
    address = _address(bind)
    return bind == "localhost" or (address is not None and address.is_loopback)


def _address(text: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    """The address; None if the text is a name."""
    try:
        return ipaddress.ip_address(text)
    except ValueError:
        return None


def rules(
    bind: str,
    port: int,
    names: tuple[str, ...] = (),
    certificate: Path | None = None,
    key: Path | None = None,
    token: str = "",
) -> Access:
    """Check the options and make the rules; `names`: further host names of the console.

    Raises:
        AccessError: The options are unsafe or inconsistent.
    """
    if bind != "localhost" and _address(bind) is None:
        raise AccessError(
            f"--bind {bind}: not an IP address; allowed: 127.0.0.1, ::1, or an address of this "
            "machine"
        )
    _check_files(certificate, key)
    _check_token(token)
    local = is_loopback(bind)
    if not local and (certificate is None or not token):
        options = {"--tls CERT KEY": certificate, "--token-file": token}
        missing = " and ".join(option for option, value in options.items() if not value)
        raise AccessError(
            f"--bind {bind}: on a network the console needs TLS and a token, or anybody there "
            f"could move the arm; {missing} is missing"
        )
    known = [*names, *(LOOPBACK_NAMES if local else ()), *_own_address(bind)]
    if not known:
        raise AccessError(
            f"--bind {bind}: give --host-name, the name or address under which people open the page"
        )
    hosts = {f"{name.lower()}:{port}" for name in known}
    if port == (443 if certificate else 80):
        hosts |= {name.lower() for name in known}
    pair = None if certificate is None or key is None else (certificate, key)
    return Access(bind, port, known[0], frozenset(hosts), token, pair)


def _check_files(certificate: Path | None, key: Path | None) -> None:
    if (certificate is None) != (key is None):
        raise AccessError("--tls: certificate and key belong together; give both files, or neither")
    for what, file in (("certificate", certificate), ("key", key)):
        if file is not None and not file.is_file():
            raise AccessError(f"--tls: {what} {file}: no such file")


def _check_token(token: str) -> None:
    if token and len(token) < MIN_TOKEN:
        raise AccessError(
            f"--token-file: the token has {len(token)} characters; at least {MIN_TOKEN} are "
            "needed (openssl rand -hex 16)"
        )
    if not token.isascii() or any(letter.isspace() for letter in token):
        raise AccessError("--token-file: a token is one word of ASCII letters and digits")


def _own_address(bind: str) -> list[str]:
    """The listen address as a host name, unless it stands for all addresses."""
    address = ipaddress.ip_address("127.0.0.1" if bind == "localhost" else bind)
    if address.is_unspecified:
        return []
    return [f"[{address}]" if address.version == 6 else str(address)]


def read_token(file: Path) -> str:
    """Read the token: the first line of a file that only its owner can read.

    Raises:
        AccessError: The file cannot be read, or others can read it.
    """
    try:
        mode = file.stat().st_mode
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise AccessError(f"--token-file {file}: {error}") from error
    if mode & 0o077:
        raise AccessError(f"--token-file {file}: others can read it; run chmod 600 {file}")
    return text.partition("\n")[0].strip()
