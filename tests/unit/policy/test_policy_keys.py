"""Key files: who can read them, what is never overwritten, what ZeroMQ makes of them."""

import os
from pathlib import Path

import pytest

from surg_policy_client import BadKeys, keys


def test_both_sides_get_what_they_need_and_nothing_else(tmp_path: Path) -> None:
    old = os.umask(0)
    try:
        made = keys.make(tmp_path / "keys")
    finally:
        os.umask(old)
    root = tmp_path / "keys"
    assert {str(path.relative_to(root)): oct(path.stat().st_mode & 0o777) for path in made} == {
        "server/server.key_secret": "0o600",
        "server/server.key": "0o644",
        "server/clients/policy.key": "0o644",
        "policy/policy.key_secret": "0o600",
        "policy/server.key": "0o644",
    }
    server, client = keys.server_keys(root), keys.client_keys(root)
    assert client.server == server.public
    assert server.clients == {"policy": client.public}
    assert keys.client_keys(root / "policy") == client
    assert keys.server_keys(root / "server") == server
    assert client.secret.decode() not in repr(client)
    assert server.secret.decode() not in repr(server)


def test_a_second_policy_joins_and_nothing_is_overwritten(tmp_path: Path) -> None:
    first = {path: path.read_bytes() for path in keys.make(tmp_path)}
    keys.make(tmp_path, "laboratory")
    assert sorted(keys.server_keys(tmp_path).clients) == ["laboratory", "policy"]
    assert keys.client_keys(tmp_path / "laboratory").server == keys.server_keys(tmp_path).public
    for name in ("policy", "laboratory"):
        with pytest.raises(BadKeys, match="nothing is overwritten"):
            keys.make(tmp_path, name)
    assert {path: path.read_bytes() for path in first} == first


@pytest.mark.parametrize("half", ["server.key", "server.key_secret"])
def test_half_of_a_pair_is_not_made_up_for(half: str, tmp_path: Path) -> None:
    keys.make(tmp_path)
    (tmp_path / "server" / half).unlink()
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(BadKeys, match="lacks one of"):
        keys.make(tmp_path, "laboratory")
    assert sorted(tmp_path.rglob("*")) == before


def test_a_file_that_came_meanwhile_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "x.key").write_text("somebody's")
    with pytest.raises(BadKeys, match="nothing is overwritten"):
        keys._create(tmp_path, "x")
    assert (tmp_path / "x.key").read_text() == "somebody's"


@pytest.mark.parametrize("name", ["server", "", "../x", "a/b", ".hidden", "x" * 65])
def test_bad_names_are_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(BadKeys, match="letters, digits"):
        keys.make(tmp_path / "keys", name)
    assert not (tmp_path / "keys").exists()


def test_a_secret_that_others_can_read_is_not_used(tmp_path: Path) -> None:
    keys.make(tmp_path)
    for part, load in (
        ("policy/policy.key_secret", keys.client_keys),
        ("server/server.key_secret", keys.server_keys),
    ):
        (tmp_path / part).chmod(0o640)
        with pytest.raises(BadKeys, match=f"chmod 600 .*{part}"):
            load(tmp_path)


@pytest.mark.parametrize("text", ["", "curve\n", 'public-key = "short"\n', "\xff\xfe"])
def test_files_that_are_no_keys_are_named(text: str, tmp_path: Path) -> None:
    keys.make(tmp_path)
    (tmp_path / "policy" / "server.key").write_text(text, "latin-1")
    with pytest.raises(BadKeys, match=r"policy/server\.key"):
        keys.client_keys(tmp_path)


def test_missing_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(BadKeys, match="exactly one"):
        keys.client_keys(tmp_path)
    with pytest.raises(BadKeys, match=r"server\.key_secret"):
        keys.server_keys(tmp_path)
    keys.make(tmp_path)
    (tmp_path / "server" / "clients" / "policy.key").unlink()
    with pytest.raises(BadKeys, match="no policy could connect"):
        keys.server_keys(tmp_path)
