"""Who may connect: where the console may listen, which Host and Origin it believes, the token.

On this machine's loopback everybody who is logged in on it may open the page. Anywhere else it is
served over TLS and with a token only. A web page from elsewhere must not reach the console through
the operator's browser: not under another host name (DNS rebinding), not by a socket from a foreign
origin.
"""

from __future__ import annotations

import hmac
import ipaddress
from dataclasses import dataclass
from pathlib import Path

SHORTEST_TOKEN = 16
LOOPBACK_NAMES = ("localhost", "127.0.0.1", "[::1]")


class AccessError(ValueError):
    """The console must not be started like this: what, and what is needed."""


@dataclass(frozen=True)
class Access:
    """The rules of one console.

    Attributes:
        bind: Address that it listens on.
        port: TCP port.
        name: Host name or address that people open.
        hosts: Values of the header Host that are answered.
        token: What every page must name first; empty on loopback.
        certificate: TLS certificate and key; None on loopback without TLS.
    """

    bind: str
    port: int
    name: str
    hosts: frozenset[str]
    token: str = ""
    certificate: tuple[Path, Path] | None = None

    @property
    def scheme(self) -> str:
        """Http or https."""
        return "https" if self.certificate else "http"

    @property
    def url(self) -> str:
        """Where the page is, without the token: this may stand in a log."""
        return f"{self.scheme}://{self.name}:{self.port}/"

    @property
    def fragment(self) -> str:
        """What a person opens has this behind `url`; the token stays in the browser, behind #."""
        return f"#token={self.token}" if self.token else ""

    def host_allowed(self, host: str | None) -> bool:
        """Whether the header Host names this console."""
        return host is not None and host.lower() in self.hosts

    def origin_allowed(self, origin: str | None) -> bool:
        """Whether a socket's header Origin is a page of this console; missing: it is none."""
        if origin is None:
            return False
        scheme, _, host = origin.lower().partition("://")
        return scheme == self.scheme and host in self.hosts

    def token_allowed(self, token: str) -> bool:
        """Whether a page has named the token, compared in constant time."""
        said = token.encode("utf-8", "surrogatepass")  # JSON can name half a character
        return hmac.compare_digest(said, self.token.encode())


def is_loopback(bind: str) -> bool:
    """Whether an address is this machine's own."""
    address = _address(bind)
    return bind == "localhost" or (address is not None and address.is_loopback)


def _address(text: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    """An address, or None where the text is a name."""
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
    """Check how a console shall be reached.

    Args:
        bind: Address to listen on, "127.0.0.1" or another of this machine.
        port: TCP port.
        names: Further host names that lead to it, as people type them.
        certificate: File of the TLS certificate (PEM).
        key: File of its private key (PEM).
        token: Secret that pages must name.

    Raises:
        AccessError: It must not be reached like this.
    """
    local = is_loopback(bind)
    if bind != "localhost" and _address(bind) is None:
        raise AccessError(
            f"--bind {bind}: not an IP address; allowed: 127.0.0.1, ::1, or an address of this "
            "machine"
        )
    if (certificate is None) != (key is None):
        raise AccessError("--cert and --key belong together: name both files, or neither")
    for name, file in (("--cert", certificate), ("--key", key)):
        if file is not None and not file.is_file():
            raise AccessError(f"{name} {file}: no such file")
    if not local and (certificate is None or not token):
        missing = " and ".join(
            word
            for word, there in (("--cert and --key", certificate), ("--token-file", token))
            if not there
        )
        raise AccessError(
            f"--bind {bind}: off this machine the console is served over TLS and with a token "
            f"only, or anybody on the network could move the arm; {missing} is missing"
        )
    if token and len(token) < SHORTEST_TOKEN:
        raise AccessError(
            f"--token-file: the token has {len(token)} characters; at least {SHORTEST_TOKEN} are "
            "needed (openssl rand -hex 16)"
        )
    if not token.isascii() or any(letter.isspace() for letter in token):
        raise AccessError("--token-file: a token is one word of ASCII letters and digits")
    address = ipaddress.ip_address("127.0.0.1" if bind == "localhost" else bind)
    known = [*names, *(LOOPBACK_NAMES if local else ())]
    if not address.is_unspecified:
        known.append(f"[{address}]" if address.version == 6 else str(address))
    if not known:
        raise AccessError(
            f"--bind {bind}: say with --host-name under which name or address people open the page"
        )
    hosts = {f"{name.lower()}:{port}" for name in known}
    if port == (443 if certificate else 80):
        hosts |= {name.lower() for name in known}
    pair = None if certificate is None or key is None else (certificate, key)
    return Access(bind, port, known[0], frozenset(hosts), token, pair)


def read_token(file: Path) -> str:
    """The first line of a file that only its owner can read.

    Raises:
        AccessError: There is no such file, or others can read it.
    """
    try:
        mode = file.stat().st_mode
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise AccessError(f"--token-file {file}: {error}") from error
    if mode & 0o077:
        raise AccessError(f"--token-file {file}: others may read it; run chmod 600 {file}")
    return text.partition("\n")[0].strip()
