"""Access to the console: loopback, TLS, token."""

from __future__ import annotations

from pathlib import Path

import pytest

from surg_console.web import access


def test_loopback_needs_nothing() -> None:
    rules = access.rules("127.0.0.1", 8090)
    assert rules.url == "http://localhost:8090/"
    for host in ("localhost:8090", "127.0.0.1:8090", "[::1]:8090", "LOCALHOST:8090"):
        assert rules.host_allowed(host), host
    for host in (
        None,
        "",
        "localhost",
        "evil.example:8090",
        "localhost:8091",
        "localhost.evil:8090",
    ):
        assert not rules.host_allowed(host), host
    assert rules.origin_allowed("http://localhost:8090")
    for origin in (None, "null", "https://localhost:8090", "http://evil.example", "file://"):
        assert not rules.origin_allowed(origin), origin


@pytest.mark.parametrize("bind", ["0.0.0.0", "192.168.1.7", "::", "10.0.0.1"])
def test_off_loopback_needs_tls_and_token(bind: str, tmp_path: Path) -> None:
    pem = tmp_path / "a.pem"
    pem.write_text("x")
    token = "0123456789abcdef"
    for how, missing in (
        ({}, "--tls CERT KEY and --token-file is missing"),
        ({"token": token}, "--tls CERT KEY is missing"),
        ({"certificate": pem, "key": pem}, "--token-file is missing"),
    ):
        with pytest.raises(access.AccessError, match="needs TLS and a token") as caught:
            access.rules(bind, 8090, ("robot",), **how)
        assert missing in str(caught.value)
    rules = access.rules(bind, 8090, ("robot",), pem, pem, token)
    assert rules.url == "https://robot:8090/", "it stands in the console's log"
    assert rules.fragment == f"#token={token}"
    assert rules.host_allowed("robot:8090")
    assert not rules.host_allowed("localhost:8090")
    assert rules.origin_allowed("https://robot:8090")
    assert not rules.origin_allowed("http://robot:8090")
    assert rules.token_allowed(token)
    assert not rules.token_allowed("") and not rules.token_allowed(token + "0")
    assert not rules.token_allowed("ä" * 16) and not rules.token_allowed("\ud800")


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"bind": "robot"}, "not an IP address"),
        ({"certificate": Path("/nowhere")}, "belong together"),
        ({"certificate": Path("/nowhere"), "key": Path("/nowhere")}, "no such file"),
        ({"token": "short"}, "at least 16"),
        ({"token": "two words that are long"}, "one word"),
    ],
)
def test_what_cannot_be_meant_is_refused(how: dict[str, object], said: str) -> None:
    with pytest.raises(access.AccessError, match=said):
        access.rules(**{"bind": "127.0.0.1", "port": 8090, **how})


def test_a_token_file_is_for_its_owner_alone(tmp_path: Path) -> None:
    file = tmp_path / "token"
    file.write_text("0123456789abcdef\n")
    file.chmod(0o644)
    with pytest.raises(access.AccessError, match="chmod 600"):
        access.read_token(file)
    file.chmod(0o600)
    assert access.read_token(file) == "0123456789abcdef"
    with pytest.raises(access.AccessError, match="No such file"):
        access.read_token(tmp_path / "none")
